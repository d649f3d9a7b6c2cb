"""Drawing of faults in states: seed and golden profile determine a fault, before any injected flight.

`stage_balanced` (the paper's equal number of injections per stage): state of the stage, uniform; field, uniform;
publication, uniform; element, uniform; bit, uniform within a stratum.  The same draw serves any named group of fields.

`messages`: publication, uniform; then a bit of its serialized message, uniform within a stratum.

The publication may also be drawn as injectors of the authors of MAVFI choose it, see `faults.sampling.When`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mavfi.errors import BadInputError, not_known
from mavfi.faults.fault import NO_SITE, FaultSite
from mavfi.faults.sampling import When, choose_publication, draw_publication, pick, stream
from mavfi.faults.strata import CLASS_STRATA, EACH_CLASS, WORD_BITS, bits_of, word_share
from mavfi.levels.state.fault import StateFault
from mavfi.record import Profile
from mavfi.states import (
    AUTOPILOTS,
    MONITORED_SETS,
    PPC_STAGES,
    PUBLISHED_SITES,
    STATES,
    VECTORS,
    StateSpec,
    find_state,
    states_with,
)


@dataclass(frozen=True, slots=True)
class FieldTarget:
    """A stage or a named group: by state, the fields from which faults are drawn; no state is empty."""

    name: str
    fields: dict[str, tuple[str, ...]]

    def within(self, stratum: str) -> "FieldTarget":
        """The fields with bits in the stratum; raises a BadInputError if there are none."""
        fields = {}
        for state, names in self.fields.items():
            names_in_stratum = tuple(name for name in names if bits_of(STATES[state].find(name), stratum))
            if names_in_stratum:
                fields[state] = names_in_stratum
        if not fields:
            raise BadInputError(f"{self.name}: no field has bits of the stratum {stratum!r}")
        return FieldTarget(self.name, fields)

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


def stage_target(
    stage: str, autopilot: str, monitored_set: str | None = None, localization: str = "truth"
) -> FieldTarget:
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
    return FieldTarget(stage, {state: names for state, names in fields.items() if names})


def published_target(stage: str) -> FieldTarget:
    """The fields of a stage that the authors' injector of states can change, see `PUBLISHED_SITES`."""
    return FieldTarget(
        stage, {state: names for state, names in PUBLISHED_SITES.items() if STATES[state].stage == stage}
    )


def group_target(name: str, sites: Sequence[str], localization: str = "truth") -> FieldTarget:
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
    return FieldTarget(name, fields)


def draw(
    target: FieldTarget,
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
    state = pick(random, tuple(part.fields))
    name = pick(random, part.fields[state])
    spec = STATES[state]
    field = spec.find(name)
    time_us, element = draw_publication(random, profile, FaultSite(state, name), when)
    bits = bits_of(field, stratum)
    if stratum == EACH_CLASS:
        bits = bits_of(field, pick(random, tuple(name for name in CLASS_STRATA if bits_of(field, name))))
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


def message_target(state: str) -> FieldTarget:
    """All fields of a message, with the lengths of its lists; raises a BadInputError for an unknown state."""
    spec = find_state(state)
    return FieldTarget(state, {state: tuple(dict.fromkeys(field.name for field in (*spec.fields, *spec.lengths)))})


class FieldBits(NamedTuple):
    """A field of a message: its name, its number of copies, and the bits of a stratum in each copy."""

    name: str
    copies: int
    bits: range


def message_bits(state: str, stratum: str, count: int) -> tuple[list[FieldBits], float]:
    """The bits of a stratum in a message whose lists have `count` elements.

    Header fields that share their name with a list are left out, as are the standard header and the number of the
    message (see `levels.state.carriers`).

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
    chosen = choose_publication(random, profile, state, np.arange(len(times)), when)
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
