"""The sampling scheme: seed and golden profile determine a fault, before any injected flight.

`stage_balanced` (the paper's equal number of injections per stage): state of the stage, uniform; field, uniform;
publication, uniform; element, uniform; bit, uniform within a stratum.  The same draw serves any named group of fields.

`messages`: publication, uniform; then a bit of its serialized message, uniform within a stratum.

The publication may also be drawn as injectors of the authors of MAVFI choose it, see `When`.
"""

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from mavfi.errors import BadInputError, not_known
from mavfi.faults.fault import NO_SITE, FaultSite, StateFault
from mavfi.faults.strata import CLASS_STRATA, EACH_CLASS, WORD_BITS, bits_of, word_share
from mavfi.record import Profile
from mavfi.states import (
    AUTOPILOTS,
    MONITORED_SETS,
    PPC_STAGES,
    PUBLISHED_SITES,
    STATES,
    VECTORS,
    Stage,
    StateSpec,
    find_state,
    states_with,
)

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


@dataclass(frozen=True, slots=True)
class Target:
    """A stage or a named group: by state, the fields from which faults are drawn; no state is empty."""

    name: str
    fields: dict[str, tuple[str, ...]]

    def within(self, stratum: str) -> "Target":
        """The fields with bits in the stratum; raises a BadInputError if there are none."""
        fields = {}
        for state, names in self.fields.items():
            names_in_stratum = tuple(name for name in names if bits_of(STATES[state].find(name), stratum))
            if names_in_stratum:
                fields[state] = names_in_stratum
        if not fields:
            raise BadInputError(f"{self.name}: no field has bits of the stratum {stratum!r}")
        return Target(self.name, fields)

    def probability(self, state: str) -> float:
        """Probability of drawing any given field of the state."""
        return 1 / len(self.fields) / len(self.fields[state])


def live_fields(spec: StateSpec, autopilot: str) -> tuple[str, ...]:
    """Unique names of the fields that some consumer reads; for a custom autopilot profile, in any shipped one."""
    autopilots: tuple[str, ...] = AUTOPILOTS
    if autopilot in AUTOPILOTS:
        autopilots = (autopilot,)
    live = (field.name for field in spec.fields if not all(field.dead_in(name) for name in autopilots))
    return tuple(dict.fromkeys(live))


def stage_target(stage: str, autopilot: str, monitored_set: str | None = None, localization: str = "truth") -> Target:
    """All live fields of the states of a stage.

    The autopilot profile determines dead fields, the localization the existing states; a monitored set
    restricts them to its own fields. Raises a BadInputError for an unknown stage or set.
    """
    if stage not in PPC_STAGES:
        raise BadInputError(f"stage {not_known(stage, PPC_STAGES)}")
    fields = {
        spec.name: live_fields(spec, autopilot) for spec in states_with(localization).values() if spec.stage == stage
    }
    if monitored_set is not None:
        if monitored_set not in MONITORED_SETS:
            raise BadInputError(f"monitored set {not_known(monitored_set, MONITORED_SETS)}")
        monitored = set(MONITORED_SETS[monitored_set])
        fields = {state: tuple(name for name in names if (state, name) in monitored) for state, names in fields.items()}
    return Target(stage, {state: names for state, names in fields.items() if names})


def published_target(stage: str) -> Target:
    """The fields of a stage that the authors' injector of states can change, see `PUBLISHED_SITES`."""
    return Target(stage, {state: names for state, names in PUBLISHED_SITES.items() if STATES[state].stage == stage})


def group_target(name: str, sites: Sequence[str], localization: str = "truth") -> Target:
    """The named fields, e.g. "planning.waypoint.x".

    Raises a BadInputError if a site is not a known field, or its state is not published with this localization.
    """
    fields: dict[str, tuple[str, ...]] = {}
    for site in sites:
        state, _, field_name = site.rpartition(".")
        spec = find_state(state)
        spec.find(field_name)
        if not spec.exists_with(localization):
            raise BadInputError(f"group {name!r}: {site}: only flights with localization {spec.only_with} publish it")
        fields[state] = (*fields.get(state, ()), field_name)
    if not fields:
        raise BadInputError(f"group {name!r}: names no site")
    return Target(name, fields)


def stream(seed: int, *key: int | str) -> np.random.Generator:
    """The random stream of a fault, addressed by the mission's seed and a key of numbers and names."""
    numbers = []
    for part in key:
        if isinstance(part, str):
            numbers.append(zlib.crc32(part.encode()))
        else:
            numbers.append(part)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(FAULT_PURPOSE, *numbers)))


def draw(
    target: Target,
    stratum: str,
    profile: Profile,
    seed: int,
    *address: int | str,
    when: When = "uniform",
    together: bool = False,
) -> StateFault:
    """Draw one fault: a field of the target, a publication of the golden run, and a bit of the stratum.

    Its time is `NO_SITE` if the golden run has no such publication of the field. The address is environment and number
    in the mission: without it, environments with equal seeds would be injected at the same sites.  With `together`, a
    component of a vector is hit with the two others, each in a bit of its own of the same stratum.
    """
    random = stream(seed, target.name, *address)
    part = target.within(stratum)
    state = _pick(random, tuple(part.fields))
    name = _pick(random, part.fields[state])
    spec = STATES[state]
    field = spec.find(name)
    time_us, element = draw_publication(random, profile, FaultSite(state, name), when)
    bits = bits_of(field, stratum)
    if stratum == EACH_CLASS:
        bits = bits_of(field, _pick(random, tuple(name for name in CLASS_STRATA if bits_of(field, name))))
    fault = StateFault(
        FaultSite(state, name, element),
        time_us,
        bit=bits[int(random.integers(len(bits)))],
        stratum=stratum,
        weight=word_share(field, stratum) * target.probability(state) / part.probability(state),
        seed=seed,
    )
    if not together:
        return fault
    # Components of a vector have the same type, and so the same bits.
    others = [other for vector in VECTORS if name in vector for other in vector if other != name]
    return replace(fault, also=tuple((other, bits[int(random.integers(len(bits)))]) for other in others))


def message_target(state: str) -> Target:
    """All fields of a message, with the lengths of its lists; raises a BadInputError for an unknown state."""
    spec = find_state(state)
    return Target(state, {state: tuple(dict.fromkeys(field.name for field in (*spec.fields, *spec.lengths)))})


class FieldBits(NamedTuple):
    """A field of a message: its name, its number of copies, and the bits of a stratum in each copy."""

    name: str
    copies: int
    bits: range


def message_bits(state: str, stratum: str, count: int) -> tuple[list[FieldBits], float]:
    """The bits of a stratum in a message whose lists have `count` elements.

    Header fields that share their name with a list are left out, as are the standard header and the number of the
    message (see `faults.levels.transit`).

    Returns:
        The bits, by field, and the stratum's share of the message.
    """
    spec = STATES[state]
    parts = []
    message_size = 0
    for name in message_target(state).fields[state]:
        field = spec.find(name)
        copies = 1
        if spec.in_elements(name):
            copies = count
        parts.append(FieldBits(field.name, copies, bits_of(field, stratum)))
        message_size += WORD_BITS[field.dtype] * copies
    return parts, sum(part.copies * len(part.bits) for part in parts) / message_size


def locate_bit(parts: Sequence[FieldBits], number: int) -> tuple[str, int, int]:
    """Field, copy and bit of a bit of `message_bits`, given by its number, from 0.

    Raises:
        IndexError: There are fewer bits.
    """
    for name, copies, bits in parts:
        if number < copies * len(bits):
            copy, index = divmod(number, len(bits))
            return name, copy, bits[index]
        number -= copies * len(bits)
    raise IndexError(number)


def draw_in_message(
    state: str, stratum: str, profile: Profile, seed: int, *address: int | str, when: When = "uniform"
) -> StateFault:
    """Draw one fault: a publication of the golden run, then a bit of the stratum in its message, uniformly.

    Its weight is the stratum's share of the message.  Its time is `NO_SITE` if the golden run has no such publication
    of the state, or the drawn one has no bit of the stratum.
    """
    random = stream(seed, f"message {state}", *address)
    spec = STATES[state]
    nowhere = StateFault(FaultSite(state, spec.fields[0].name), NO_SITE, 0, stratum, 0.0, seed)
    # The publication.
    times = profile.times_us.get(state, np.zeros(0, np.int64))
    chosen = _choose_publication(random, profile, state, np.arange(len(times)), when)
    if chosen is None:
        return nowhere
    # The bit of its message.
    parts, share = message_bits(state, stratum, int(profile.counts[state][chosen]))
    total = sum(part.copies * len(part.bits) for part in parts)
    if total == 0:
        return replace(nowhere, weight=share)
    name, copy, bit = locate_bit(parts, int(random.integers(total)))
    site = FaultSite(state, name)
    if spec.in_elements(name):
        site = FaultSite(state, name, copy)
    return StateFault(site, int(times[chosen]), bit, stratum, share, seed)


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
    chosen = _choose_publication(random, profile, site.state, candidates, when)
    if chosen is None:
        return NO_SITE, site.element
    element = site.element
    if in_elements and element is None:
        element = int(random.integers(int(counts[chosen])))
    return int(times[chosen]), element


def _choose_publication(
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


def _pick(random: np.random.Generator, names: tuple[str, ...]) -> str:
    """One of some names, uniformly."""
    return names[int(random.integers(len(names)))]
