"""Faults as text: `null`, `state:planning.waypoint.x`, `state:planning.trajectory.x[3]:bit=62@5.0`."""

import dataclasses
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from mavfi.dropped import dropped_name
from mavfi.errors import BadInputError
from mavfi.faults.fault import LIFETIME, MODELS, RESTART_S, FaultSite, InstructionFault, Model, StateFault
from mavfi.faults.levels.sensor.fault import SensorFault
from mavfi.faults.sampling import draw_publication, live_fields, stream
from mavfi.faults.spec_form import wrong_part
from mavfi.faults.strata import WORD_BITS
from mavfi.record import Profile
from mavfi.states import KERNELS, STATES, WATCHING, Field, StateSpec, states_with

_PATTERN = re.compile(
    r"(?P<path>[^:@\[\]]+)(\[(?P<element>\d+)\])?(:bit=(?P<bit>\d+))?(:width=(?P<width>\d+))?(:times=(?P<times>\d+))?"
    r"(:lasts=(?P<lasts>inf|\d+(\.\d*)?))?(:share=(?P<share>\d+(\.\d*)?))?(@(?P<time>\d+(\.\d*)?([eE][+-]?\d+)?))?"
)
_MEMORY = re.compile(r"(?P<path>[^:@]+)(:bit=(?P<bit>\d+))?(@(?P<time>\d+(\.\d*)?([eE][+-]?\d+)?))?")
_SENSOR = re.compile(
    r"(?P<unit>[a-z_]+)(?P<instance>\d+)?:(?P<kind>\w+)(:lasts=(?P<lasts>inf|\d+(\.\d*)?))?"
    r"(@(?P<time>\d+(\.\d*)?([eE][+-]?\d+)?))?"
)
_INSTRUCTION = re.compile(r"(?P<kernel>\w+)(:which=(?P<which>.+?))?(:model=(?P<model>\w+))?")
_ONE_INSTRUCTION = re.compile(
    r"(?P<kernel>\w+)\.(?P<entry>\w+):call=(?P<call>\d+):index=(?P<index>\d+)"
    r":(bit=(?P<bits>\d+(\+\d+)*)|value=0x(?P<value>[\da-f]+))(:model=(?P<model>\w+))?(:restart=(?P<restart>\d+(\.\d*)?))?"
    r":budget=(?P<budget>\d+):ir=(?P<ir>[\da-f]{64})"
)
_LONGEST = 1e9


@dataclass(frozen=True, slots=True)
class StateRequest:
    """A fault in a state as requested by the user: field, list element, bit, earliest instant; None is drawn.

    A null fault flips nothing; `lifetime` has the given keys of `fault.LIFETIME`.
    """

    state: StateSpec
    field: str | None = None
    element: int | None = None
    bit: int | None = None
    time_us: int | None = None
    null: bool = False
    lifetime: Mapping[str, Any] = dataclasses.field(default_factory=dict, hash=False)

    @property
    def needs_profile(self) -> bool:
        """Whether the golden run is needed first, to draw from its publications."""
        some_element = bool(self.state.elements) and self.element is None
        return self.time_us is None or some_element

    def resolve(self, seed: int, autopilot: str, profile: Profile | None = None) -> StateFault:
        """Draw what was not given; bits uniformly from the whole word.

        Args:
            seed: Seed of the fault.
            autopilot: Name of the autopilot profile; a field without consumers is injected only if requested.
            profile: Publications of the golden run, if `needs_profile`.
        """
        random = stream(seed, "spec", self.state.name)
        field, width = self._field(random, autopilot), self.lifetime.get("width", 1)
        where = FaultSite(self.state.name, field.name, self.element)
        time_us = self.time_us or 0
        if self.needs_profile:
            drawn, element = draw_publication(random, self._later(profile or Profile()), where)
            where = FaultSite(self.state.name, field.name, element)
            time_us = drawn if self.time_us is None else self.time_us
        drawn_bit = int(random.integers(WORD_BITS[field.dtype] - width + 1)) if self.bit is None else self.bit
        bit = None if self.null else drawn_bit
        return StateFault(where, time_us, bit, seed=seed, **self.lifetime)

    def _field(self, random: np.random.Generator, autopilot: str) -> Field:
        if self.field is not None:
            return self.state.find(self.field)
        fields = [self.state.find(name) for name in live_fields(self.state, autopilot)]
        if self.element is not None:
            fields = [field for field in fields if self.state.in_elements(field.name)]
        bits = (self.bit or 0) + self.lifetime.get("width", 1)
        fields = [field for field in fields if bits <= WORD_BITS[field.dtype]]
        return fields[int(random.integers(len(fields)))]

    def _later(self, profile: Profile) -> Profile:
        """The publications from which the element is drawn: only the first one from the requested time on."""
        name = self.state.name
        if self.time_us is None or name not in profile.times_us:
            return profile
        later = np.flatnonzero((profile.times_us[name] >= self.time_us) & (profile.counts[name] > 0))[:1]
        return Profile({name: profile.times_us[name][later]}, {name: profile.counts[name][later]})


@dataclass(frozen=True, slots=True)
class MemoryRequest:
    """A fault in the memory of a kernel as requested by the user; anything not given is drawn by exposure.

    Attributes:
        kernel: As in `states.KERNELS`, or in `states.WATCHING`.
        field: Name of words, or a part of it, with an optional index (see `pipeline.words.Words.named`); "" = all.
        bit: None = drawn from the whole word.
        time_us: None = drawn from the golden run.
    """

    kernel: str
    field: str = ""
    bit: int | None = None
    time_us: int | None = None


@dataclass(frozen=True, slots=True)
class InstructionRequest:
    """Faults in instructions to be drawn from one mission.

    Attributes:
        kernels: Number of faults in each kernel, by the names of `states.INJECTABLE` and `states.DETECTORS`.
        which: Class of instructions, see `mavfi.faults.levels.instruction.selection`.
        model: How the value is changed.
        restart_s: Time after which a crashed node has restarted (s).
    """

    kernels: Mapping[str, int]
    which: str = "all"
    model: Model = "one_bit"
    restart_s: float = RESTART_S

    @property
    def kernel(self) -> str:
        """The first kernel: the only one of a command-line request."""
        return next(iter(self.kernels))


@dataclass(frozen=True, slots=True)
class InstructionSite:
    """A fault in one dynamic instruction of one call; nothing is drawn.

    Attributes:
        kernel: As in `states.INJECTABLE` and `states.DETECTORS`.
        entry: Its function, an attribute of `pipeline.functions.KernelFunctions`.
        given: Other attributes of the `fault.InstructionFault`.
    """

    kernel: str
    entry: str
    given: Mapping[str, Any] = dataclasses.field(hash=False)

    @staticmethod
    def text_of(fault: InstructionFault) -> str:
        """The text of a fault in a kernel or detector; inverse of `parse`."""
        value = f"bit={'+'.join(map(str, fault.bits))}" if fault.bits else f"value={fault.value:#x}"
        model = "" if fault.model == "one_bit" else f":model={fault.model}"
        restart = "" if fault.restart_s == RESTART_S else f":restart={fault.restart_s}"
        return (
            f"instruction:{fault.kernel}.{fault.entry}:call={fault.call}:index={fault.index}:{value}{model}{restart}"
            f":budget={fault.budget}:ir={fault.ir_sha256}"
        )


@dataclass(frozen=True, slots=True)
class SensorRequest:
    """A failure of a sensor or motor as requested by the user.

    Attributes:
        fault: The failure.
        drawn: Whether its start is drawn from the golden run.
    """

    fault: SensorFault
    drawn: bool

    def resolve(self, seed: int, flight_time_us: int, *address: int | str) -> SensorFault:
        """The failure; an instant that is not given is uniform over a flight of some length (us)."""
        if not self.drawn:
            return dataclasses.replace(self.fault, seed=seed)
        random = stream(seed, "sensor", self.fault.unit, self.fault.kind, *address)
        return dataclasses.replace(self.fault, seed=seed, time_us=int(random.integers(flight_time_us)))

    @staticmethod
    def text_of(fault: SensorFault) -> str:
        """The text of a failure; inverse of `parse`."""
        lasts = "" if fault.lasts_s == float("inf") else f":lasts={fault.lasts_s}"
        return f"sensor:{fault.device}:{fault.kind}{lasts}@{fault.time_us / 1e6}"


Request = StateRequest | MemoryRequest | InstructionRequest | InstructionSite | SensorRequest


def parse(text: str, localization: str = "truth", levels: Collection[str] = ()) -> Request:
    """Parse a fault from the command line.

    Args:
        text: `null` (the empty mask on the way-point in force), `state:` and a site, `memory:` and a kernel with an
            optional name in its memory, `instruction:` and a kernel, or one of its instructions, or `sensor:`, a
            unit and a type of failure.
        localization: "truth" or "estimator", which determines the existing states.
        levels: Levels that a host can inject; empty = all.

    Raises:
        BadInputError: Another level; unknown state, field, element or bit; the message lists the existing ones.
    """
    level, _, rest = text.partition(":")
    if levels and level not in {"null", *levels}:
        raise BadInputError(
            f"fault {text!r}: allowed here: null, {', '.join(f'{name}:...' for name in sorted(levels))}"
        )
    return _PARSERS.get(level, _not_understood)(text, rest, localization)


def parse_sensor(text: str, seed: int) -> SensorFault:
    """Parse a failure that begins at a given instant.

    Raises:
        BadInputError: Another form, or no instant.
    """
    request = _parse_sensor(text, text.partition(":")[2], "")
    if request.drawn:
        raise BadInputError(f"fault {text!r}: without an instant; allowed: ...@SECONDS")
    return request.resolve(seed, 0)


def _not_understood(text: str, rest: str, _localization: str) -> NoReturn:
    raise BadInputError(f"fault {text!r}: {wrong_part(text.partition(':')[0], rest)}")


def _parse_null(text: str, rest: str, localization: str) -> StateRequest:
    if text != "null":
        _not_understood(text, rest, localization)
    return StateRequest(STATES["planning.waypoint"], "x", null=True)


def _refuse_register(text: str, _rest: str, _localization: str) -> NoReturn:
    raise BadInputError(
        f"fault {text!r}: registers are injected by mavfi inject; allowed: state, memory, instruction, sensor"
    )


def _parse_memory(text: str, rest: str, localization: str) -> MemoryRequest:
    match = _MEMORY.fullmatch(rest)
    if match is None:
        _not_understood(text, rest, localization)
    kernel, _, field = match["path"].partition(".")
    known = [*(spec.name for spec in KERNELS.values() if spec.only_with in ("", localization)), *WATCHING]
    if dropped_name("kernels", kernel):
        raise BadInputError(f"fault {text!r}: {dropped_name('kernels', kernel)}")
    if kernel not in known:
        raise BadInputError(f"fault {text!r}: no kernel {kernel!r}; allowed: {', '.join(known)}")
    bit = None if match["bit"] is None else int(match["bit"])
    return MemoryRequest(kernel, field, bit, _instant(text, match["time"]))


def _instant(text: str, seconds: str | None) -> int | None:
    """An instant in text form (s), in us."""
    if seconds is None:
        return None
    if not float(seconds) <= _LONGEST:
        raise BadInputError(f"fault {text!r}: instant {seconds} s; allowed: 0 to {_LONGEST:g}")
    return round(float(seconds) * 1e6)


def _parse_sensor(text: str, rest: str, localization: str) -> SensorRequest:
    del localization
    match = _SENSOR.fullmatch(rest)
    if match is None:
        _not_understood(text, rest, "")
    instant = _instant(text, match["time"])
    try:
        fault = SensorFault(
            match["unit"], match["kind"], instant or 0, float(match["lasts"] or "inf"), int(match["instance"] or 0)
        )
    except BadInputError as error:
        raise BadInputError(f"fault {text!r}: {error}") from None
    return SensorRequest(fault, drawn=instant is None)


def _parse_instruction(text: str, rest: str, localization: str) -> InstructionRequest | InstructionSite:
    from mavfi.faults.levels.instruction.selection import parse_selection

    one = _ONE_INSTRUCTION.fullmatch(rest)
    if one is not None:
        return _instruction_site(text, one)
    match = _INSTRUCTION.fullmatch(rest)
    if match is None:
        _not_understood(text, rest, localization)
    which = match["which"] or "all"
    try:
        parse_selection(which)
    except BadInputError as error:
        raise BadInputError(f"fault {text!r}: {error}") from None
    return InstructionRequest({match["kernel"]: 1}, which, _model(text, match["model"]))


def _instruction_site(text: str, match: re.Match[str]) -> InstructionSite:
    given: dict[str, Any] = {name: int(match[name]) for name in ("call", "index", "budget")}
    given |= {"ir_sha256": match["ir"], "model": _model(text, match["model"])}
    given |= (
        {"bits": tuple(map(int, match["bits"].split("+")))} if match["bits"] else {"value": int(match["value"], 16)}
    )
    if match["restart"] is not None:
        given["restart_s"] = float(match["restart"])
    return InstructionSite(match["kernel"], match["entry"], given)


def _model(text: str, name: str | None) -> Any:
    """A fault model; by default, one bit."""
    if name is not None and name not in MODELS:
        raise BadInputError(f"fault {text!r}: no model {name!r}; allowed: {', '.join(MODELS)}")
    return name or "one_bit"


def _parse_state(text: str, rest: str, localization: str) -> StateRequest:
    match = _PATTERN.fullmatch(rest)
    if match is None:
        _not_understood(text, rest, localization)
    spec, field = _find(text, match["path"], localization)
    element, bit = (None if match[name] is None else int(match[name]) for name in ("element", "bit"))
    if field is None:
        named, fields, has_elements = spec.name, spec.fields, bool(spec.elements)
    else:
        named, fields, has_elements = f"{spec.name}.{field}", (spec.find(field),), spec.in_elements(field)
    if element is not None and not has_elements:
        raise BadInputError(f"fault {text!r}: element [{element}]: {named} is no list; allowed: no element")
    bits = max(WORD_BITS[candidate.dtype] for candidate in fields)
    lifetime = _lifetime(match)
    last = (bit or 0) + lifetime.get("width", 1) - 1
    if last >= bits:
        raise BadInputError(f"fault {text!r}: no bit {last} in {named}; allowed: 0 to {bits - 1}")
    try:
        StateFault(FaultSite(spec.name, field or spec.fields[0].name), **lifetime)
    except BadInputError as error:
        raise BadInputError(f"fault {text!r}: {error}") from None
    return StateRequest(spec, field, element, bit, _instant(text, match["time"]), lifetime=lifetime)


def _lifetime(match: re.Match[str]) -> dict[str, Any]:
    """The given keys of `LIFETIME`."""
    found = {name: match[name.removesuffix("_s")] for name in LIFETIME}
    return {name: type(LIFETIME[name])(value) for name, value in found.items() if value is not None}


def _find(text: str, path: str, localization: str) -> tuple[StateSpec, str | None]:
    state, _, field = (path, "", "") if path in STATES else path.rpartition(".")
    known = states_with(localization)
    if state not in STATES:
        raise BadInputError(f"fault {text!r}: no state {path!r}; allowed: {', '.join(known)}")
    if state not in known:
        only = STATES[state].only_with
        raise BadInputError(f"fault {text!r}: {state} is published with localization {only} only, not {localization}")
    try:
        return known[state], known[state].find(field).name if field else None
    except BadInputError as error:
        raise BadInputError(f"fault {text!r}: {error}") from None


_PARSERS: dict[str, Callable[[str, str, str], Request]] = {
    "null": _parse_null,
    "state": _parse_state,
    "memory": _parse_memory,
    "instruction": _parse_instruction,
    "register": _refuse_register,
    "sensor": _parse_sensor,
}
"""By level; arguments are the whole text, its part after the level, and the localization."""
