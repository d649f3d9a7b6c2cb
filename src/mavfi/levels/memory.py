"""Faults in kernel memory, as text: `memory:planner`, `memory:waypoint.points[33]:bit=62@20.0`.

They are drawn by exposure: uniform over stored bits and instants of the golden flight.  Instants are the control
periods.  At each of them, before its steps, every bit of a target replaces the fault drawn so far with the probability
that makes all bits of all instants equally likely (reservoir sampling, Vitter 1985), so one golden flight suffices, and
none of its states are stored.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from mavfi.detectors.detector import part_of
from mavfi.dropped import dropped_name
from mavfi.errors import BadInputError, hint
from mavfi.faults.fault import NO_SITE, Fault, MemoryFault
from mavfi.faults.operations import OPERATIONS, VALUE_OPERATIONS, PlannedChange
from mavfi.faults.plug_ins import plug_ins_of_spec, without_module
from mavfi.faults.sampling import stream
from mavfi.faults.strata import WORD_BITS, bits_of
from mavfi.flight.targets import find_plug_in, plug_ins_of
from mavfi.levels.campaign import SampledCampaign
from mavfi.levels.level import (
    NULL,
    SECONDS,
    WHOLE,
    Draw,
    Golden,
    Level,
    Sampled,
    Sampler,
    Sampling,
    change_text,
    check_distinct,
    check_strata,
    is_change,
    parse_value_change,
)
from mavfi.levels.state import SiteGroup, group_json, smaller_changes
from mavfi.pipeline.words import Words, collapsed, words_of
from mavfi.states import KERNEL_STAGES, KERNELS, PLUG_INS, WATCHING, unknown

if TYPE_CHECKING:
    from mavfi.flight.host import ArmSetup, Flight, MissionFlights
    from mavfi.flight.memory_faults import MemoryInjector

MemorySite = tuple[str, str]
"""A kernel, a detector or recovery, and a name of its words (see `Words.named`)."""


class _Region(NamedTuple):
    """Words of a kernel's memory from which faults are drawn."""

    kernel: str
    words: Words
    indices: range


@dataclass(frozen=True, slots=True)
class MemoryRequest:
    """A fault in the memory of a kernel as requested by the user; anything not given is drawn by exposure.

    Attributes:
        kernel: As in `states.KERNELS`, or in `states.WATCHING`; or what a plug-in is called.
        field: Name of words, or a part of it, with an optional index (see `pipeline.words.Words.named`); "" = all.
        bit: None = drawn from the whole word.
        time_us: None = drawn from the golden run.
        lasts_s: As in `MemoryFault`.
        change: As in `MemoryFault`.
    """

    kernel: str
    field: str = ""
    bit: int | None = None
    time_us: int | None = None
    lasts_s: float = 0.0
    change: PlannedChange | None = None

    def draw(self, setup: "ArmSetup", seed: int) -> "tuple[MemoryFault, Flight | None]":
        """See `Request.draw`; a BadInputError if the target has no such word or bit at that instant."""
        owner = _owner(self.kernel, setup)
        in_detector = owner.in_detector
        if not in_detector:
            setup = replace(setup, make_detector=None)

        # Draw while the golden flight is flown.
        random = stream(seed, "memory", owner.name)
        exposure = Exposure(((owner.name, self.field),), "", self.bit, [_Drawing(random, seed)])
        golden = fly_exposed(setup, [exposure], self.time_us)
        (fault,) = exposure.faults()

        # Without a site, say which words the target remembers instead.
        if not fault.has_site:
            names = collapsed(words.name for words in exposure.latest.get(owner.name, ()))
            if owner.role and not names:
                raise BadInputError(
                    f"fault memory:{self.kernel}: {owner.name} declares no memory; allowed: arrays by name, in its "
                    "method `arrays` (docs/how-to/own-kernels.md)"
                )
            bit_text = ""
            if self.bit is not None:
                bit_text = f" with a bit {self.bit}"
            when = ""
            if self.time_us is not None:
                when = f" at {1e-6 * self.time_us:g} s"
            raise BadInputError(
                f"fault memory:{self.kernel}.{self.field}: no such word{bit_text}{when}{hint(self.field, names)}; "
                f"allowed: {', '.join(names)}"
            )
        # The word is drawn as for a flip, and then changed as requested.
        bit = fault.bit
        if self.change is not None and self.change.operation.name != "flip":
            bit = None
        fault = replace(fault, bit=bit, lasts_s=self.lasts_s, change=self.change)
        if in_detector:
            return fault, None
        return fault, golden


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
        seen: Exposed bits x instants so far.
        seen_in_words: The same count for whole words.
        latest: The latest words, by kernel.
        roles: Kinds of the plug-ins, by name.
    """

    sites: tuple[MemorySite, ...]
    stratum: str = ""
    bit: int | None = None
    drawings: list[_Drawing] = field(default_factory=list)
    seen: int = 0
    seen_in_words: int = 0
    latest: Mapping[str, Sequence[Words]] = field(default_factory=dict)
    roles: Mapping[str, str] = field(default_factory=dict)

    def observe(self, remembered: Mapping[str, Sequence[Words]], now: int) -> None:
        """Update the drawings with the words at an instant (us)."""
        self.latest = remembered
        # The exposed bits at this instant, and so far.
        regions = self._regions(remembered)
        sizes = [len(region.indices) * len(self._bits(region.words)) for region in regions]
        exposed = sum(sizes)
        self.seen += exposed
        self.seen_in_words += sum(len(region.indices) * WORD_BITS[region.words.dtype] for region in regions)
        # Reservoir sampling: this instant replaces the choice with the probability of its share.
        for drawing in self.drawings:
            if drawing.random.random() * self.seen < exposed:
                drawing.chosen = self._choose(drawing, regions, sizes, now)

    def _regions(self, remembered: Mapping[str, Sequence[Words]]) -> list[_Region]:
        """The target's words; those of a type without bits are left out."""
        regions: list[_Region] = []
        for kernel, text in self.sites:
            for words in remembered.get(kernel, ()):
                if words.dtype not in WORD_BITS:
                    continue
                indices = words.named(text)
                if indices:
                    regions.append(_Region(kernel, words, indices))
        return regions

    def _bits(self, words: Words) -> range:
        """The bits of a word from which faults are drawn."""
        bits = range(WORD_BITS[words.dtype])
        if self.stratum:
            bits = bits_of(words, self.stratum)
        if self.bit is None:
            return bits
        if self.bit in bits:
            return range(self.bit, self.bit + 1)
        return range(0)

    def _choose(self, drawing: _Drawing, regions: list[_Region], sizes: list[int], now: int) -> MemoryFault:
        """A bit of some regions, uniformly; `sizes` are their numbers of bits."""
        number = int(drawing.random.integers(sum(sizes)))
        position = 0
        while number >= sizes[position]:
            number -= sizes[position]
            position += 1
        kernel, words, indices = regions[position]
        bits = self._bits(words)
        index = None
        if words.count > 1:
            index = indices[number // len(bits)]
        return MemoryFault(
            kernel,
            words.name,
            index,
            words.dtype,
            now,
            bits[number % len(bits)],
            self.stratum,
            seed=drawing.seed,
            role=self.roles.get(kernel, ""),
        )

    def faults(self) -> list[MemoryFault]:
        """The drawn faults with their weight; a target without words gives faults without a site."""
        kernel, name = self.sites[0]
        nothing = MemoryFault(kernel, name, time_us=NO_SITE, stratum=self.stratum, role=self.roles.get(kernel, ""))
        weight = 1.0
        if self.stratum and self.seen_in_words:
            weight = self.seen / self.seen_in_words
        return [replace(drawing.chosen or nothing, weight=weight, seed=drawing.seed) for drawing in self.drawings]


def fly_exposed(setup: "ArmSetup", exposures: Sequence[Exposure], time_us: int | None = None) -> "Flight":
    """Fly the golden flight of an arm, and draw from its memory at an instant (us), or at every control period."""
    from mavfi.flight.compose import new_loop, watch
    from mavfi.flight.loop import CONTROL_PERIOD_US
    from mavfi.flight.memory_faults import memory_of

    # The flight, with the detector whose memory is a target, or none.
    loop = new_loop(setup.scenario, profile=True)
    detector = setup.detector()
    watch(loop, detector, setup.recovery)
    targets = dict.fromkeys(target for exposure in exposures for target, _ in exposure.sites)
    roles = {plug_in.name: plug_in.role for plug_in in plug_ins_of(setup.scenario, detector)}
    for exposure in exposures:
        exposure.roles = roles

    def words(target: str) -> list[Words]:
        """The words that a target remembers now."""
        holder = memory_of(loop, target, detector, roles.get(target, ""))
        if holder is None:
            return []
        return list(words_of(holder))

    def look(now: int) -> None:
        """Show them to the exposures."""
        remembered = {name: words(name) for name in targets}
        for exposure in exposures:
            exposure.observe(remembered, now)

    # Look at the memory of all targets at these instants, before the steps.
    instants: Sequence[int] = range(0, loop.judge.limit_us, CONTROL_PERIOD_US)
    if time_us is not None:
        instants = (time_us,)
    for instant in instants:
        loop.call_at(instant, look)
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
        """Check names of kernels, groups and strata."""
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

    draws_together = False

    def __init__(self, campaign: SampledCampaign) -> None:
        super().__init__(campaign)
        spec = campaign.first_mission
        self._kernels = _kernels_with(spec.localization)
        self._plug_ins = plug_ins_of_spec(spec)
        self._detectors = campaign.custom_detectors
        self._sites = self._find_targets()
        self.targets = dict.fromkeys(self._sites, self.sampling.strata or {"": 1.0})
        self.arms = {name: self._flown_in(sites) for name, sites in self._sites.items()}

    def _find_targets(self) -> dict[str, tuple[MemorySite, ...]]:
        """The sites of each target, in the order of the plan."""
        sampling = self.sampling
        if sampling.groups:
            return {group.name: tuple(map(self._site, group.sites)) for group in sampling.groups}
        sites = [self._site(kernel) for kernel in sampling.kernels or self._kernels]
        if sampling.share == "kernel":
            return {kernel: ((kernel, name),) for kernel, name in sites}
        return {"memory": tuple(sites)}

    def _site(self, text: str) -> MemorySite:
        """The site in a text "KERNEL.WORD", or of all words of a kernel."""
        kernel, name = _site(text)
        if kernel in (*self._kernels, *WATCHING):
            return kernel, name
        for plug_in in (*self._plug_ins, *self._detectors.values()):
            if plug_in.is_called(kernel):
                return plug_in.name, name
        names = [plug_in.name for plug_in in (*self._plug_ins, *self._detectors.values())]
        raise BadInputError(f"sampling: {_refusal(kernel, (*self._kernels, *WATCHING, *names))}")

    def _flown_in(self, sites: tuple[MemorySite, ...]) -> str:
        """The arm in whose golden runs faults of a target are drawn; "" = the campaign's own mission."""
        arms: set[str] = set()
        for name, _ in sites:
            watching = [arm for arm, plug_in in self._detectors.items() if plug_in.name == name]
            if name in WATCHING:
                watching = [self.campaign.arm_with(name)]
            arms.update(watching or [""])
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
            number = self.repetition(draw.index)
            random = stream(draw.seed, "memory", draw.target, environment, number)
            key = draw.target, draw.stratum
            exposure = exposures.setdefault(key, Exposure(self._sites[draw.target], draw.stratum))
            exposure.drawings.append(_Drawing(random, draw.seed))
        if self.campaign.nulls and not arm:
            seed = setup.scenario.seed
            all_kernels = Exposure(tuple((kernel, "") for kernel in self._kernels))
            all_kernels.drawings.append(_Drawing(stream(seed, "memory", NULL, environment), seed))
            exposures[NULL, ""] = all_kernels
        golden = fly_exposed(setup, list(exposures.values()))
        flights.register_golden(arm, golden)
        return Sampled(golden, faults={key: exposure.faults() for key, exposure in exposures.items()})

    def null(self, index: int, seed: int, environment: str, golden: Golden) -> Fault:
        """A fault with an empty mask, drawn from the memory of all kernels."""
        del index, environment
        fault = MemoryFault(self._kernels[0], "", time_us=NO_SITE, seed=seed)
        if "" in golden:
            drawn: Any = golden[""].faults[NULL, ""]
            fault = next(iter(drawn), fault)
        return replace(fault, bit=None)


def _kernels_with(localization: str) -> list[str]:
    """The kernels that run with a localization."""
    return [name for name, row in KERNELS.items() if row.only_with in ("", localization)]


class _Owner(NamedTuple):
    """Whose memory a fault is in.

    Attributes:
        name: As in a fault.
        role: Kind of the plug-in, as in `states.PLUG_INS`; "" = of mavfi.
    """

    name: str
    role: str = ""

    @property
    def in_detector(self) -> bool:
        """Whether it is a detector."""
        return self.role == "detector" or (not self.role and self.name in WATCHING)


def _owner(name: str, setup: "ArmSetup") -> _Owner:
    """Whose memory a request means in a mission; a BadInputError if nobody's."""
    from mavfi.detectors.registry import check_watched

    scenario = setup.scenario
    detector = setup.detector()
    kernels = _kernels_with(scenario.localization.kind)
    if name in kernels:
        return _Owner(name)
    if name in WATCHING:
        check_watched(name, detector)
        return _Owner(name)
    plug_in = find_plug_in(name, scenario, detector)
    if plug_in is not None:
        return _Owner(plug_in.name, plug_in.role)
    names = [plug_in.name for plug_in in plug_ins_of(scenario, detector)]
    watched = [source for source in WATCHING if part_of(detector, source) is not None]
    raise BadInputError(f"fault memory:{name}: {_refusal(name, (*kernels, *names, *watched))}")


def _refusal(kernel: str, allowed: Sequence[str]) -> str:
    """Why there is no such memory."""
    return dropped_name("kernels", kernel) or unknown("kernel", kernel, allowed)


def _site(text: str) -> MemorySite:
    """The site in a text "KERNEL.WORD"."""
    kernel, _, name = text.partition(".")
    return kernel, name


class MemoryLevel(Level):
    """Faults in the memory of kernels and detectors."""

    fault = MemoryFault
    sampling = MemorySampling
    sampler = MemorySampler
    local = True
    form = "memory:KERNEL[.FIELD][[INDEX]][:bit=N][:lasts=S][@SECONDS]"
    options = {"bit": WHOLE, "lasts": SECONDS}
    operations = (*VALUE_OPERATIONS, "times=", "every=", "share=")
    reductions = {"bit": smaller_changes}
    absent = ("remembered", "the kernel did not remember such a word then")

    def parse(self, text: str, localization: str) -> MemoryRequest:
        """See `Level.parse`."""
        change = None
        text = without_module(text, OPERATIONS)
        if is_change(text):
            body, at, instant = text.partition("@")
            site, *options = body.split(":")
            change, bit, time_us, lasts_s = parse_value_change(options, instant, has_instant=bool(at))
        else:
            parts = self.parts_of(text)
            site = parts.site
            bit = parts.options.get("bit")
            time_us = parts.time_us
            lasts_s = parts.options.get("lasts", 0.0)
        kernel, name = _site(site)
        if not kernel:
            self.not_understood()
        if change is not None:
            checked_bit = None
            if change.operation.name == "flip":
                checked_bit = bit or 0
            # Checks the change; whose memory it is depends on the mission.
            MemoryFault(kernel, name, bit=checked_bit, lasts_s=lasts_s, change=change, role=next(iter(PLUG_INS)))
        return MemoryRequest(kernel, name, bit, time_us, lasts_s, change)

    def shipped_site(self, request: MemoryRequest) -> bool:
        """See `Level.shipped_site`."""
        return request.kernel in KERNELS or request.kernel in WATCHING

    def text_of(self, fault: MemoryFault) -> str:
        """See `Level.text_of`."""
        if fault.change is not None:
            return f"{fault.site}:{change_text(fault.change, fault.bit, fault.time_us, fault.lasts_s)}"
        options = ""
        if fault.bit is not None:
            options = f":bit={fault.bit}"
        if fault.lasts_s > 0.0:
            options += f":lasts={fault.lasts_s}"
        return f"{fault.site}{options}@{fault.time_us / 1e6}"

    def seed_of(self, fault: MemoryFault) -> int | None:
        """See `Level.seed_of`: an intermittent fault draws its instants."""
        if fault.change is not None and fault.change.when.share < 1.0:
            return fault.seed
        return None

    def inject(self, loop: Any, fault: MemoryFault, detector: Any) -> "MemoryInjector":
        """See `Level.inject`."""
        from mavfi.flight.memory_faults import MemoryInjector

        injector = loop.taps.injector = MemoryInjector(loop, fault, detector)
        return injector

    def columns(self, fault: MemoryFault) -> dict[str, Any]:
        """See `Level.columns`."""
        stage: str = KERNEL_STAGES.get(fault.kernel, "")  # "": a detector
        if fault.role:
            stage = PLUG_INS[fault.role].stage
        columns: dict[str, Any] = {
            "stage": str(stage),
            "kernel": fault.kernel,
            "field": fault.field,
            "element": fault.index,
        }
        if fault.stratum:
            columns["population"] = fault.stratum
        if fault.change is not None:
            columns["operation"] = fault.change.name
        return columns

    def about(self, campaign: SampledCampaign) -> dict[str, Any]:
        """See `Level.about`."""
        sampling = campaign.sampling
        unit = {"kernel": "kernel", "exposure": "environment"}[sampling.share]
        if sampling.groups:
            unit = "group"
        return {"each": unit, "how": "uniform over remembered bits and instants"}
