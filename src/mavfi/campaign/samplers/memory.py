"""Faults in kernel memory, drawn by exposure: uniform over stored bits and instants of the golden flight.

Instants are the control periods.  At each of them, before its steps, every bit of a target replaces the fault drawn so
far with the probability that makes all bits of all instants equally likely (reservoir sampling, Vitter 1985), so one
golden flight suffices, and none of its states are stored.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mavfi.campaign.config import Campaign, MemorySampling
from mavfi.campaign.samplers.sampler import NULL, Block, Draw, Sampled, TargetBlocks, watched_in
from mavfi.detectors.detector import Detector
from mavfi.dropped import dropped_name
from mavfi.errors import BadInputError, hint
from mavfi.faults.fault import NO_SITE, Fault, MemoryFault
from mavfi.faults.sampling import stream
from mavfi.faults.spec import MemoryRequest
from mavfi.faults.strata import WORD_BITS, bits_of
from mavfi.flight.case import check_watched
from mavfi.flight.compose import new_loop, watch
from mavfi.flight.decide import INLINE, Recovery
from mavfi.flight.host import ArmSetup, Flight, MissionFlights
from mavfi.flight.loop import CONTROL_PERIOD_US, Loop
from mavfi.flight.memory_faults import memory_of
from mavfi.mission import Scenario
from mavfi.pipeline.words import Words, collapsed, words_of
from mavfi.states import KERNELS, WATCHING

_ACTION = "exposure"
Site = tuple[str, str]
"""A kernel, a detector or recovery, and a name of its words (see `Words.named`)."""
_Place = tuple[str, Words, range]


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
                indices = words.named(text) if words.dtype in WORD_BITS else range(0)
                if indices:
                    found.append((kernel, words, indices))
        return found

    def _bits(self, words: Words) -> range:
        every = bits_of(words, self.stratum) if self.stratum else range(WORD_BITS[words.dtype])
        return every if self.bit is None else range(self.bit, self.bit + 1) if self.bit in every else range(0)

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
        weight = self.seen / self.whole if self.stratum and self.whole else 1.0
        return [replace(one.chosen or nothing, weight=weight, seed=one.seed) for one in self.drawings]


def fly_exposed(
    scenario: Scenario, exposures: Sequence[Exposure], time_us: int | None = None, detector: Detector | None = None,
    recovery: Recovery = INLINE,
) -> Flight:  # fmt: skip
    """Fly the golden flight, and draw from its memory at an instant (us), or at every control period."""
    loop = new_loop(scenario, profile=True)
    watch(loop, detector, recovery)
    targets = dict.fromkeys(target for exposure in exposures for target, _ in exposure.sites)

    def look(now: int) -> None:
        remembered = {name: _words(loop, name, detector) for name in targets}
        for exposure in exposures:
            exposure.look(remembered, now)

    loop.actions[_ACTION] = look
    for instant in range(0, loop.judge.limit_us, CONTROL_PERIOD_US) if time_us is None else (time_us,):
        loop.at(instant, _ACTION)
    return loop.fly()


def _words(loop: Loop, target: str, detector: Detector | None) -> list[Words]:
    holder = memory_of(loop, target, detector)
    return [] if holder is None else list(words_of(holder))


def draw_memory(
    scenario: Scenario, request: MemoryRequest, seed: int, detector: Detector | None = None,
    recovery: Recovery = INLINE,
) -> tuple[MemoryFault, Flight]:  # fmt: skip
    """Draw the fault of a user's request; also returns the golden flight of the draw.

    A detector, with its recovery, is flown only if the fault is in its memory.

    Raises:
        BadInputError: The target's memory has no such word, or none with such a bit, at that instant.
    """
    if request.kernel in WATCHING:
        check_watched(request.kernel, detector)
    else:
        detector = None
    random = stream(seed, "memory", request.kernel)
    exposure = Exposure(((request.kernel, request.field),), "", request.bit, [_Drawing(random, seed)])
    golden = fly_exposed(scenario, [exposure], request.time_us, detector, recovery)
    (fault,) = exposure.faults()
    if not fault.has_site:
        names = collapsed(words.name for words in exposure.latest.get(request.kernel, ()))
        when = "" if request.time_us is None else f" at {1e-6 * request.time_us:g} s"
        bit = "" if request.bit is None else f" with a bit {request.bit}"
        raise BadInputError(
            f"fault memory:{request.kernel}.{request.field}: no such word{bit}{when}{hint(request.field, names)}; "
            f"allowed: {', '.join(names)}"
        )
    return fault, golden


class MemorySampler:
    """Draws one bit of a word in the memory of a kernel or a detector.

    Faults in a detector are drawn from the golden run of its arm, and injected in that arm alone.

    Raises:
        BadInputError: The sampling names a target that is not part of the mission, or of one arm.
    """

    variants: Mapping[str, Mapping[str, Any]] = {}
    instruments = False
    versions: Mapping[str, str] = {}

    def __init__(self, campaign: Campaign) -> None:
        assert isinstance(campaign.sampling, MemorySampling)  # as `sampler_for` chooses
        spec = campaign.spec(campaign.environments[0], campaign.first_seed)
        self._campaign, self._sampling = campaign, campaign.sampling
        self._known = [name for name, row in KERNELS.items() if row.only_with in ("", spec.localization)]
        self._targets = self._find_targets()
        shares = dict.fromkeys(self._targets, self._sampling.strata or {"": 1.0})
        arms = {name: self._flown_in(sites) for name, sites in self._targets.items()}
        self._blocks = TargetBlocks(campaign, shares, variants=arms)

    def _find_targets(self) -> dict[str, tuple[Site, ...]]:
        sampling = self._sampling
        kernels = sampling.kernels or tuple(self._known)
        if sampling.groups:
            targets = {group.name: tuple(map(_site, group.sites)) for group in sampling.groups}
        elif sampling.share == "kernel":
            targets = {kernel: ((kernel, ""),) for kernel in kernels}
        else:
            targets = {"memory": tuple((kernel, "") for kernel in kernels)}
        for kernel, _ in (site for sites in targets.values() for site in sites):
            if dropped_name("kernels", kernel):
                raise BadInputError(f"sampling: {dropped_name('kernels', kernel)}")
            if kernel not in (*self._known, *WATCHING):
                raise BadInputError(f"sampling: no kernel {kernel!r}; allowed: {', '.join((*self._known, *WATCHING))}")
        return targets

    def _flown_in(self, sites: tuple[Site, ...]) -> str:
        """The arm in whose golden runs faults of a target are drawn; "" = the campaign's own mission."""
        arms = {watched_in(self._campaign, name) if name in WATCHING else "" for name, _ in sites}
        if len(arms) != 1:
            raise BadInputError(f"sampling: {', '.join(name for name, _ in sites)}: allowed: targets of one arm")
        return arms.pop()

    def blocks(self, environment: str) -> Sequence[Block]:
        """One block per target."""
        return self._blocks.of(environment)

    def golden(
        self, arm: str, draws: Sequence[Draw], environment: str, flights: MissionFlights, setup: ArmSetup
    ) -> Sampled:  # fmt: skip
        """Fly the golden run, and draw its faults."""
        if arm and not draws:
            return Sampled(flights.golden(arm))
        exposures: dict[tuple[str, str], Exposure] = {}
        for draw in draws:
            number = draw.index // self._campaign.missions
            random = stream(draw.seed, "memory", draw.target, environment, number)
            self._exposure(exposures, draw.target, draw.stratum).drawings.append(_Drawing(random, draw.seed))
        if self._campaign.nulls and not arm:
            seed = setup.scenario.seed
            every = exposures[NULL, ""] = Exposure(tuple((kernel, "") for kernel in self._known))
            every.drawings.append(_Drawing(stream(seed, "memory", NULL, environment), seed))
        golden = fly_exposed(setup.scenario, list(exposures.values()), None, setup.detector(), setup.recovery)
        flights.know(arm, golden)
        return Sampled(golden, faults={"/".join(key): exposure.faults() for key, exposure in exposures.items()})

    def _exposure(self, known: dict[tuple[str, str], Exposure], target: str, stratum: str) -> Exposure:
        return known.setdefault((target, stratum), Exposure(self._targets[target], stratum))

    def draw(self, draws: Sequence[Draw], environment: str, golden: Mapping[str, Sampled]) -> list[Fault | None]:
        """The faults drawn by `golden`, in order; None for each fault of a failed golden run."""
        del environment
        waiting = {key: iter(found) for sampled in golden.values() for key, found in sampled.faults.items()}
        return [next(waiting.get(f"{d.target}/{d.stratum}", iter(())), None) for d in draws]

    def null(self, index: int, seed: int, environment: str, golden: Mapping[str, Sampled]) -> Fault:
        """A fault with an empty mask, drawn from the memory of all kernels."""
        del index, environment
        found = golden[""].faults[f"{NULL}/"] if "" in golden else ()
        fault = next(iter(found), None) or MemoryFault(self._known[0], "", time_us=NO_SITE, seed=seed)
        assert isinstance(fault, MemoryFault)  # this sampler draws no other type
        return replace(fault, bit=None)


def _site(text: str) -> Site:
    kernel, _, name = text.partition(".")
    return kernel, name
