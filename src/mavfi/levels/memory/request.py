"""A fault in memory as requested by a user: what is not given is drawn by exposure."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

from mavfi.detectors.detector import part_of
from mavfi.detectors.registry import check_watched
from mavfi.dropped import dropped_name
from mavfi.errors import BadInputError, hint
from mavfi.faults.changes import Change
from mavfi.faults.sampling import stream
from mavfi.flight.targets import find_plug_in, plug_ins_of
from mavfi.levels.memory.exposure import Exposure, FaultDrawing, fly_exposed
from mavfi.levels.memory.fault import MemoryFault
from mavfi.pipeline.words import collapsed
from mavfi.states import KERNELS, WATCHING, unknown

if TYPE_CHECKING:
    from mavfi.flight.host import ArmSetup, Flight


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
    change: Change | None = None

    def draw(self, setup: "ArmSetup", seed: int) -> "tuple[MemoryFault, Flight | None]":
        """See `Request.draw`; a BadInputError if the target has no such word or bit at that instant."""
        owner = _owner(self.kernel, setup)
        in_detector = owner.in_detector
        if not in_detector:
            setup = replace(setup, make_detector=None)

        # Draw while the golden flight is flown.
        random = stream(seed, "memory", owner.name)
        exposure = Exposure(((owner.name, self.field),), "", self.bit, [FaultDrawing(random, seed)])
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


def kernels_with(localization: str) -> list[str]:
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
    scenario = setup.scenario
    detector = setup.detector()
    kernels = kernels_with(scenario.localization.kind)
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
    raise BadInputError(f"fault memory:{name}: {refusal_of(name, (*kernels, *names, *watched))}")


def refusal_of(kernel: str, allowed: Sequence[str]) -> str:
    """Why there is no such memory."""
    return dropped_name("kernels", kernel) or unknown("kernel", kernel, allowed)
