"""Faults in instructions of kernels and detectors, uniform over all executed instructions of a mission.

As text: `instruction:pid`, `instruction:pid:which=floating_point:model=zero`, or one instruction as printed by `mavfi
shrink`.  Faults in a single compiled function, without a flight, are in `levels.instruction.api`.
"""

import re
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from mavfi.errors import BadInputError, not_known
from mavfi.faults.fault import RESTART_S, Fault, FliesFrom, find_level
from mavfi.faults.plug_ins import without_module
from mavfi.ir.injection.table import parse_selection
from mavfi.levels.campaign import SampledCampaign
from mavfi.levels.instruction.api import InjectedCall, count, draw, histogram, inject, resolve, run_forked
from mavfi.levels.instruction.drawing import InstructionRequest, InstructionSite
from mavfi.levels.instruction.fault import MODELS, InstructionFault
from mavfi.levels.instruction.sampling import InstructionSampler, InstructionSampling, campaign_targets, stage_of
from mavfi.levels.level import COMBINED, DECIMAL, WHOLE, Level
from mavfi.record import Injection
from mavfi.states import DETECTORS, INJECTABLE

if TYPE_CHECKING:
    from mavfi.flight.host import ArmSetup, Flight
    from mavfi.flight.instruction_cases import Published

__all__ = [
    "InjectedCall",
    "InstructionFault",
    "InstructionLevel",
    "count",
    "draw",
    "histogram",
    "inject",
    "resolve",
    "run_forked",
]

_ONE_INSTRUCTION = re.compile(
    rf"""(?P<kernel>[\w-]+)\.(?P<entry>\w+)
    :call=(?P<call>\d+)
    :index=(?P<index>\d+)
    :(bit=(?P<bits>\d+(\+\d+)*)|value=0x(?P<value>[\da-f]+))
    (:model=(?P<model>\w+))?
    (:restart=(?P<restart>{DECIMAL}))?
    (:times=(?P<times>\d+))?
    :budget=(?P<budget>\d+)
    :ir=(?P<ir>[\da-f]{{64}})""",
    re.VERBOSE,
)
"""A fault in one instruction, as written by `InstructionLevel.text_of`."""


def lower_bits(fault: InstructionFault, _: Injection | None) -> Iterator[Fault]:
    """Faults in less significant bits."""
    return (replace(fault, bits=(bit,), stratum="") for bit in range(fault.bit or 0))


def single_bit_faults(fault: InstructionFault, _: Injection | None) -> Iterator[Fault]:
    """Single-bit faults for a multi-bit one."""
    if len(fault.bits) > 1:
        yield from (replace(fault, bits=(bit,)) for bit in sorted(fault.bits))


class InstructionLevel(Level):
    """Faults in instructions of compiled functions; flights of the host `local` fork at the injected call."""

    fault = InstructionFault
    sampling = InstructionSampling
    sampler = InstructionSampler
    local = True
    form = "instruction:KERNEL[:which=CLASS][:model=MODEL][:times=N], or one instruction as printed by mavfi shrink"
    options = {"which": (".+", "a class of instructions", str), "model": (r"\w+", "a model", str), "times": WHOLE}
    reductions = {"width": single_bit_faults, "bit": lower_bits}
    absent = ("executed", "the instruction was not executed")

    def parse(self, text: str, localization: str) -> InstructionRequest | InstructionSite:
        """See `Level.parse`."""
        instruction = _ONE_INSTRUCTION.fullmatch(text)
        if instruction is not None:
            return InstructionSite(_fault_in(instruction))
        text = without_module(text)
        kernel = text.partition(":")[0]
        if not re.fullmatch(r"[\w-]+", kernel):
            self.not_understood()
        parts = self.parts_of(text)
        if parts.time_us is not None:
            self.not_understood()
        which = parts.options.get("which", "all")
        parse_selection(which)
        times = parts.options.get("times", 1)
        InstructionFault("", "", 0, kernel=kernel, times=times)  # checks the number
        return InstructionRequest({kernel: 1}, which, _model(parts.options.get("model")), times=times)

    def shipped_site(self, request: InstructionRequest | InstructionSite) -> bool:
        """See `Level.shipped_site`."""
        return isinstance(request, InstructionSite) or not set(request.kernels) - {*INJECTABLE, *DETECTORS}

    def text_of(self, fault: InstructionFault) -> str | None:
        """See `Level.text_of`."""
        if not fault.kernel:
            return None
        value = f"value={fault.value:#x}"
        if fault.bits:
            value = f"bit={'+'.join(map(str, fault.bits))}"
        model = ""
        if fault.model != "one_bit":
            model = f":model={fault.model}"
        restart = ""
        if fault.restart_s != RESTART_S:
            restart = f":restart={fault.restart_s}"
        times = ""
        if fault.times != 1:
            times = f":times={fault.times}"
        return (
            f"instruction:{fault.kernel}.{fault.entry}:call={fault.call}:index={fault.index}:{value}{model}{restart}{times}"
            f":budget={fault.budget}:ir={fault.ir_sha256}"
        )

    def flies_from(self, fault: InstructionFault) -> FliesFrom:
        """See `Level.flies_from`."""
        if fault.times > 1:
            return FliesFrom.CALLS
        return FliesFrom.CALL

    def fly_forked(
        self, setup: "ArmSetup", fault: InstructionFault, detector: Any, *, records: bool = False
    ) -> "tuple[Flight, list[Published]]":
        """See `Level.fly_forked`: as one of several faults."""
        combined = find_level(COMBINED)
        flown: tuple[Flight, list[Published]] = combined.fly_forked(
            setup, combined.fault((fault,), (None,)), detector, records=records
        )
        return flown

    def columns(self, fault: InstructionFault) -> dict[str, Any]:
        """See `Level.columns`."""
        return {
            "stage": stage_of(fault.kernel, fault.role),
            "kernel": fault.kernel,
            "function": fault.entry,
            "value_class": fault.value_class,
        }

    def about(self, campaign: SampledCampaign) -> dict[str, Any]:
        """See `Level.about`."""
        sampling = campaign.sampling
        how = f"instructions: {sampling.which}, model {sampling.model}"
        if sampling.when != "uniform":
            how += f", calls: {sampling.when}"
        targets = campaign_targets(campaign)
        return {
            "each": sampling.share,
            "how": how,
            "kernels": [target.name for target in targets],
            "stages": list(dict.fromkeys(target.stage for target in targets)),
            "which": sampling.which,
        }


def _fault_in(match: re.Match[str]) -> InstructionFault:
    """The fault that a text names in full."""
    bits: tuple[int, ...] = ()
    if match["bits"]:
        bits = tuple(map(int, match["bits"].split("+")))
    return InstructionFault(
        "",
        match["ir"],
        int(match["index"]),
        int(match["call"]),
        bits,
        int(match["value"] or "0", 16),
        int(match["budget"]),
        model=_model(match["model"]),
        kernel=match["kernel"],
        entry=match["entry"],
        restart_s=float(match["restart"] or RESTART_S),
        times=int(match["times"] or 1),
    )


def _model(name: str | None) -> Any:
    """A fault model; by default, one bit."""
    if name is not None and name not in MODELS:
        raise BadInputError(f"model {not_known(name, MODELS)}")
    return name or "one_bit"
