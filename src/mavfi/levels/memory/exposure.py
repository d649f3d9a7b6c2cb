"""Drawing of faults in memory by exposure: uniform over stored bits and instants of the golden flight.

Instants are the control periods.  At each of them, before its steps, every bit of a target replaces the fault drawn so
far with the probability that makes all bits of all instants equally likely (reservoir sampling, Vitter 1985), so one
golden flight suffices, and none of its states are stored.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mavfi.faults.fault import NO_SITE
from mavfi.faults.strata import WORD_BITS, bits_of
from mavfi.flight.targets import plug_ins_of
from mavfi.levels.memory.fault import MemoryFault
from mavfi.pipeline.words import Words, words_of

if TYPE_CHECKING:
    from mavfi.flight.host import ArmSetup, Flight

MemorySite = tuple[str, str]
"""A kernel, a detector or recovery, and a name of its words (see `Words.named`)."""


class _Region(NamedTuple):
    """Words of a kernel's memory from which faults are drawn."""

    kernel: str
    words: Words
    indices: range


@dataclass(slots=True)
class FaultDrawing:
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
    drawings: list[FaultDrawing] = field(default_factory=list)
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

    def _choose(self, drawing: FaultDrawing, regions: list[_Region], sizes: list[int], now: int) -> MemoryFault:
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
    from mavfi.levels.memory.injector import memory_of

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
