"""Faults in kernel memory, as text: `memory:planner`, `memory:waypoint.points[33]:bit=62@20.0`.

They are drawn by exposure: uniform over stored bits and instants of the golden flight.  Instants are the control
periods.  At each of them, before its steps, every bit of a target replaces the fault drawn so far with the probability
that makes all bits of all instants equally likely (reservoir sampling, Vitter 1985), so one golden flight suffices, and
none of its states are stored.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from mavfi.dropped import dropped_name
from mavfi.errors import BadInputError, hint
from mavfi.faults.fault import NO_SITE, Fault, MemoryFault
from mavfi.faults.sampling import stream
from mavfi.faults.strata import WORD_BITS, bits_of
from mavfi.levels.level import (
    NULL,
    WHOLE,
    Draw,
    Golden,
    Level,
    Sampled,
    Sampler,
    Sampling,
    check_distinct,
    check_strata,
)
from mavfi.levels.state import SiteGroup, group_json, lower
from mavfi.pipeline.words import Words, collapsed, words_of
from mavfi.states import KERNEL_STAGES, KERNELS, WATCHING

if TYPE_CHECKING:
    from mavfi.flight.host import ArmSetup, Flight, MissionFlights
    from mavfi.flight.memory_faults import MemoryInjector

_ACTION = "exposure"
Site = tuple[str, str]
"""A kernel, a detector or recovery, and a name of its words (see `Words.named`)."""
_Place = tuple[str, Words, range]


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

    def draw(self, setup: "ArmSetup", seed: int) -> "tuple[MemoryFault, Flight | None]":
        """See `Request.draw`; a BadInputError if the target has no such word or bit at that instant."""
        from mavfi.detectors.registry import check_watched

        watched = self.kernel in WATCHING
        if watched:
            check_watched(self.kernel, setup.detector())
        else:
            setup = replace(setup, make_detector=None)
        random = stream(seed, "memory", self.kernel)
        exposure = Exposure(((self.kernel, self.field),), "", self.bit, [_Drawing(random, seed)])
        golden = fly_exposed(setup, [exposure], self.time_us)
        (fault,) = exposure.faults()
        if not fault.has_site:
            names = collapsed(words.name for words in exposure.latest.get(self.kernel, ()))
            if self.time_us is None:
                when = ""
            else:
                when = f" at {1e-6 * self.time_us:g} s"
            bit = "" if self.bit is None else f" with a bit {self.bit}"
            raise BadInputError(
                f"fault memory:{self.kernel}.{self.field}: no such word{bit}{when}{hint(self.field, names)}; "
                f"allowed: {', '.join(names)}"
            )
        return fault, None if watched else golden


@dataclass(slots=True)
class _Drawing:
    """Drawing of one fault: its generator, and the current choice."""

    random: np.random.Generator
    seed: int
    chosen: MemoryFault | None = None


@dataclass(slots=True)
class Exposure:
    """Bits of a target from which faults are drawn.

    Attributes:
        sites: Sites of the target.
        stratum: Stratum of the bits, "" = whole words.
        bit: A single bit number; None = all of the stratum.
        drawings: The faults to be drawn.
        seen: Exposed bits x instants so far; `whole`: the same count for whole words.
        latest: The latest words, by kernel.
    """

    sites: tuple[Site, ...]
    stratum: str = ""
    bit: int | None = None
    drawings: list[_Drawing] = field(default_factory=list)
    seen: int = 0
    whole: int = 0
    latest: Mapping[str, Sequence[Words]] = field(default_factory=dict)

    def look(self, remembered: Mapping[str, Sequence[Words]], now: int) -> None:
        """Update the drawings with the words at an instant (us)."""
        self.latest, places = remembered, self._places(remembered)
        sizes = [len(indices) * len(self._bits(words)) for _, words, indices in places]
        here = sum(sizes)
        self.seen += here
        self.whole += sum(len(indices) * WORD_BITS[words.dtype] for _, words, indices in places)
        for drawing in self.drawings:
            if drawing.random.random() * self.seen < here:
                drawing.chosen = self._chosen(drawing, places, sizes, now)

    def _places(self, remembered: Mapping[str, Sequence[Words]]) -> list[_Place]:
        found: list[_Place] = []
        for kernel, text in self.sites:
            for words in remembered.get(kernel, ()):
                if words.dtype in WORD_BITS:
                    indices = words.named(text)
                else:
                    indices = range(0)
                if indices:
                    found.append((kernel, words, indices))
        return found

    def _bits(self, words: Words) -> range:
        if self.stratum:
            every = bits_of(words, self.stratum)
        else:
            every = range(WORD_BITS[words.dtype])
        if self.bit is None:
            return every
        if self.bit in every:
            return range(self.bit, self.bit + 1)
        return range(0)

    def _chosen(self, drawing: _Drawing, places: list[_Place], sizes: list[int], now: int) -> MemoryFault:
        number = int(drawing.random.integers(sum(sizes)))
        place = 0
        while number >= sizes[place]:
            number -= sizes[place]
            place += 1
        kernel, words, indices = places[place]
        bits = self._bits(words)
        index = indices[number // len(bits)] if words.count > 1 else None
        return MemoryFault(
            kernel, words.name, index, words.dtype, now, bits[number % len(bits)], self.stratum, seed=drawing.seed
        )

    def faults(self) -> list[MemoryFault]:
        """The drawn faults with their weight; a target without words gives faults without a site."""
        nothing = MemoryFault(self.sites[0][0], self.sites[0][1], time_us=NO_SITE, stratum=self.stratum)
        if self.stratum and self.whole:
            weight = self.seen / self.whole
        else:
            weight = 1.0
        return [replace(one.chosen or nothing, weight=weight, seed=one.seed) for one in self.drawings]


def fly_exposed(setup: "ArmSetup", exposures: Sequence[Exposure], time_us: int | None = None) -> "Flight":
    """Fly the golden flight of an arm, and draw from its memory at an instant (us), or at every control period."""
    from mavfi.flight.compose import new_loop, watch
    from mavfi.flight.loop import CONTROL_PERIOD_US
    from mavfi.flight.memory_faults import memory_of

    loop = new_loop(setup.scenario, profile=True)
    detector = setup.detector()
    watch(loop, detector, setup.recovery)
    targets = dict.fromkeys(target for exposure in exposures for target, _ in exposure.sites)

    def words(target: str) -> list[Words]:
        holder = memory_of(loop, target, detector)
        if holder is None:
            return []
        return list(words_of(holder))

    def look(now: int) -> None:
        remembered = {name: words(name) for name in targets}
        for exposure in exposures:
            exposure.look(remembered, now)

    loop.actions[_ACTION] = look
    for instant in range(0, loop.judge.limit_us, CONTROL_PERIOD_US) if time_us is None else (time_us,):
        loop.at(instant, _ACTION)
    return loop.fly()


class MemorySampling(Sampling):
    """Faults in memory of kernels or detectors: one bit, uniform over bits and instants of a golden run."""

    level: Literal["memory"]
    kernels: tuple[str, ...] = Field((), description="whose memory; all kernels by default")
    share: Literal["exposure", "kernel"] = Field(
        "exposure", description="what `faults` counts: all bits together, most of which are maps, or each kernel"
    )
    groups: tuple[SiteGroup, ...] = Field((), description="instead: `faults` for each of these, e.g. planner.acted_seq")
    strata: dict[str, float] | None = Field(None, description="shares of the faults by bit class; whole words else")

    @model_validator(mode="after")
    def _consistent(self) -> "MemorySampling":
        check_distinct("sampling.kernels", self.kernels)
        check_distinct("sampling.groups", [group.name for group in self.groups])
        if self.strata is not None:
            check_strata(self.strata)
        if any(group.lifetime or group.strata for group in self.groups):
            raise ValueError("sampling.groups: keys lifetime and strata: allowed with faults in states")
        return self

    def to_json(self) -> dict[str, Any]:
        """See `Sampling.to_json`."""
        return group_json(self.model_dump(mode="json"))


class MemorySampler(Sampler):
    """Draws one bit of a word in the memory of a kernel or a detector.

    Faults in a detector are drawn from the golden run of its arm, and injected in that arm alone.

    Raises:
        BadInputError: The sampling names a target that is not part of the mission, or of one arm.
    """

    def __init__(self, campaign: Any) -> None:
        super().__init__(campaign)
        spec = campaign.spec(campaign.environments[0], campaign.first_seed)
        self._known = _kernels_with(spec.localization)
        self._sites = self._find_targets()
        self.targets = dict.fromkeys(self._sites, self.sampling.strata or {"": 1.0})
        self.arms = {name: self._flown_in(sites) for name, sites in self._sites.items()}

    def _find_targets(self) -> dict[str, tuple[Site, ...]]:
        sampling = self.sampling
        kernels = sampling.kernels or tuple(self._known)
        if sampling.groups:
            targets = {group.name: tuple(map(_site, group.sites)) for group in sampling.groups}
        elif sampling.share == "kernel":
            targets = {kernel: ((kernel, ""),) for kernel in kernels}
        else:
            targets = {"memory": tuple((kernel, "") for kernel in kernels)}
        for kernel, _ in (site for sites in targets.values() for site in sites):
            try:
                _check_kernel(kernel, self._known)
            except BadInputError as error:
                raise BadInputError(f"sampling: {error}") from None
        return targets

    def _flown_in(self, sites: tuple[Site, ...]) -> str:
        """The arm in whose golden runs faults of a target are drawn; "" = the campaign's own mission."""
        arms = {self.campaign.arm_with(name) if name in WATCHING else "" for name, _ in sites}
        if len(arms) != 1:
            raise BadInputError(f"sampling: {', '.join(name for name, _ in sites)}: allowed: targets of one arm")
        return arms.pop()

    def golden(
        self, arm: str, draws: Sequence[Draw], environment: str, flights: "MissionFlights", setup: "ArmSetup"
    ) -> Sampled:
        """Fly the golden run, and draw its faults."""
        if arm and not draws:
            return Sampled(flights.golden(arm))
        exposures: dict[tuple[str, str], Exposure] = {}
        for draw in draws:
            number = draw.index // self.campaign.missions
            random = stream(draw.seed, "memory", draw.target, environment, number)
            key = draw.target, draw.stratum
            exposure = exposures.setdefault(key, Exposure(self._sites[draw.target], draw.stratum))
            exposure.drawings.append(_Drawing(random, draw.seed))
        if self.campaign.nulls and not arm:
            seed = setup.scenario.seed
            every = exposures[NULL, ""] = Exposure(tuple((kernel, "") for kernel in self._known))
            every.drawings.append(_Drawing(stream(seed, "memory", NULL, environment), seed))
        golden = fly_exposed(setup, list(exposures.values()))
        flights.register_golden(arm, golden)
        return Sampled(golden, faults={key: exposure.faults() for key, exposure in exposures.items()})

    def null(self, index: int, seed: int, environment: str, golden: Golden) -> Fault:
        """A fault with an empty mask, drawn from the memory of all kernels."""
        del index, environment
        drawn: Any = golden[""].faults[NULL, ""] if "" in golden else ()
        fault = next(iter(drawn), None) or MemoryFault(self._known[0], "", time_us=NO_SITE, seed=seed)
        return replace(fault, bit=None)


def _kernels_with(localization: str) -> list[str]:
    return [name for name, row in KERNELS.items() if row.only_with in ("", localization)]


def _check_kernel(kernel: str, known: Sequence[str]) -> None:
    if dropped_name("kernels", kernel):
        raise BadInputError(dropped_name("kernels", kernel))
    if kernel not in (*known, *WATCHING):
        raise BadInputError(f"no kernel {kernel!r}; allowed: {', '.join((*known, *WATCHING))}")


def _site(text: str) -> Site:
    kernel, _, name = text.partition(".")
    return kernel, name


class MemoryLevel(Level):
    """Faults in the memory of kernels and detectors."""

    fault = MemoryFault
    sampling = MemorySampling
    sampler = MemorySampler
    local = True
    form = "memory:KERNEL[.FIELD][[INDEX]][:bit=N][@SECONDS]"
    options = {"bit": WHOLE}
    reductions = {"bit": lower}
    absent = ("remembered", "the kernel did not remember such a word then")

    def parse(self, text: str, localization: str) -> MemoryRequest:
        """See `Level.parse`."""
        parts = self.parts_of(text)
        kernel, name = _site(parts.site)
        _check_kernel(kernel, _kernels_with(localization))
        return MemoryRequest(kernel, name, parts.options.get("bit"), parts.time_us)

    def text_of(self, fault: MemoryFault) -> str:
        """See `Level.text_of`."""
        bit = "" if fault.bit is None else f":bit={fault.bit}"
        return f"{fault.site}{bit}@{fault.time_us / 1e6}"

    def inject(self, loop: Any, fault: MemoryFault, detector: Any) -> "MemoryInjector":
        """See `Level.inject`."""
        from mavfi.flight.memory_faults import MemoryInjector

        injector = loop.taps.injector = MemoryInjector(loop, fault, detector)
        return injector

    def columns(self, fault: MemoryFault) -> dict[str, Any]:
        """See `Level.columns`."""
        stage = KERNEL_STAGES.get(fault.kernel, "")  # "": a detector
        columns = {"stage": str(stage), "kernel": fault.kernel, "field": fault.field, "element": fault.index}
        return columns | ({"population": fault.stratum} if fault.stratum else {})

    def about(self, campaign: Any) -> dict[str, Any]:
        """See `Level.about`."""
        sampling = campaign.sampling
        if sampling.groups:
            each = "group"
        else:
            each = {"kernel": "kernel", "exposure": "environment"}[sampling.share]
        return {"each": each, "how": "uniform over remembered bits and instants"}
