"""What draws of all levels share: random streams by address, shares of strata, publications of a golden run."""

import zlib
from collections.abc import Mapping
from typing import Literal

import numpy as np

from mavfi.faults.fault import NO_SITE, FaultSite
from mavfi.record import Profile
from mavfi.states import STATES, Stage

FAULT_PURPOSE = 3
"""First part of the spawn key of every fault stream."""
When = Literal["uniform", "published", "second_plan"]
"""How the publication of a fault is chosen among those of the golden run that consumers act on.

`uniform`: each with the same probability.

`published`: as by the authors' injector of states.  Perception: the first from the first collision status on.
Planning: the first of the k-th finished plan, with probability 1/2^k; of the last one if there are fewer.  Control:
each command is hit with a probability of 1/100, until one is; the last one if none is.

`second_plan`: the first from the second plan on, finished or not: their injector of registers stops the planner's node
when it plans for the second time.
"""
COLLISION = "perception.collision_status"
"""The state that marks the instants of `published` in perception."""
PLAN_CHANCE = 1 / 2
"""Probability with which the authors' injector of states hits a finished plan (MAVBench/MAV_apps, branch mavfi)."""
COMMAND_CHANCE = 1 / 100
"""Probability with which it hits a velocity command."""


def stream(seed: int, *key: int | str) -> np.random.Generator:
    """The random stream of a fault, addressed by the mission's seed and a key of numbers and names."""
    numbers = []
    for part in key:
        if isinstance(part, str):
            numbers.append(zlib.crc32(part.encode()))
        else:
            numbers.append(part)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(FAULT_PURPOSE, *numbers)))


def share_out(shares: Mapping[str, float], count: int, seed: int, *address: int | str) -> list[str]:
    """Assign a stratum to each of `count` faults: exact shares (largest remainder), in an order drawn by the seed.

    Shares need not add up to 1. The address is environment, name of the target and number of the batch (none for the
    first one); each has its own order.
    """
    total = sum(shares.values())
    exact = {stratum: count * share / total for stratum, share in shares.items()}
    numbers = {stratum: int(number) for stratum, number in exact.items()}
    by_remainder = sorted(exact, key=lambda stratum: numbers[stratum] - exact[stratum])
    for stratum in by_remainder[: count - sum(numbers.values())]:
        numbers[stratum] += 1
    strata = [stratum for stratum, number in numbers.items() for _ in range(number)]
    return [strata[index] for index in stream(seed, "strata", *address).permutation(count)]


def draw_publication(
    random: np.random.Generator, profile: Profile, site: FaultSite, when: When = "uniform"
) -> tuple[int, int | None]:
    """Draw a publication of the golden run that contains the field, and an element, uniformly, if none is given.

    Returns:
        Instant (us), or `NO_SITE`, and the element, or None if the field is not in a list.
    """
    times = profile.times_us.get(site.state, np.zeros(0, np.int64))
    counts = profile.counts.get(site.state, np.zeros(0, np.int32))
    in_elements = STATES[site.state].in_elements(site.field)
    candidates = np.arange(len(times))
    if in_elements:
        candidates = np.flatnonzero(counts > 0)
    chosen = choose_publication(random, profile, site.state, candidates, when)
    if chosen is None:
        return NO_SITE, site.element
    element = site.element
    if in_elements and element is None:
        element = int(random.integers(int(counts[chosen])))
    return int(times[chosen]), element


def choose_publication(
    random: np.random.Generator, profile: Profile, state: str, candidates: np.ndarray, when: When
) -> int | None:
    """Choose one of the publications of a state, given by their indices in the profile; None = there is no such one."""
    if len(candidates) == 0:
        return None
    stage = STATES[state].stage
    if when == "uniform":
        return int(candidates[int(random.integers(len(candidates)))])
    if when == "published" and stage is Stage.CONTROL:
        trial = int(random.geometric(COMMAND_CHANCE))
        return int(candidates[min(trial, len(candidates)) - 1])

    # The others begin at an instant of the golden run.
    if when == "second_plan":
        instants = _plan_times(profile, state, finished=False)[1:2]
    elif stage is Stage.PLANNING:
        finished = _plan_times(profile, state, finished=True)
        trial = min(int(random.geometric(PLAN_CHANCE)), len(finished))
        instants = finished[max(trial - 1, 0) : trial]
    else:
        instants = profile.times_us.get(COLLISION, np.zeros(0, np.int64))[:1]
    if len(instants) == 0:
        return None
    later = candidates[profile.times_us[state][candidates] >= instants[0]]
    if len(later) == 0:
        return None
    return int(later[0])


def _plan_times(profile: Profile, state: str, *, finished: bool) -> np.ndarray:
    """Instants from which a state may belong to a plan, one per plan (us).

    A path comes before its trajectory, all other states of a plan not before.  Plans that failed have no points; they
    are left out of the `finished` ones.
    """
    carrier = "planning.trajectory"
    if state == "planning.path":
        carrier = state
    times = profile.times_us.get(carrier, np.zeros(0, np.int64))
    if not finished:
        return times
    return times[profile.counts.get(carrier, np.zeros(0, np.int32)) > 0]


def pick(random: np.random.Generator, names: tuple[str, ...]) -> str:
    """One of some names, uniformly."""
    return names[int(random.integers(len(names)))]
