"""Faults in kernel memory, as text: `memory:planner`, `memory:waypoint.points[33]:bit=62@20.0`."""

from dataclasses import replace
from typing import Any

from mavfi.faults.changes import is_change, split_site
from mavfi.faults.fault import NO_SITE
from mavfi.faults.injector import Injector
from mavfi.faults.operations import OPERATIONS, VALUE_OPERATIONS
from mavfi.faults.plug_ins import without_module
from mavfi.levels.campaign import SampledCampaign
from mavfi.levels.level import SECONDS, WHOLE, Begin, Level, parse_fields
from mavfi.levels.memory.fault import MemoryFault
from mavfi.levels.memory.request import MemoryRequest
from mavfi.levels.memory.sampling import MemorySampler, MemorySampling
from mavfi.levels.smaller import smaller_changes
from mavfi.states import KERNEL_STAGES, KERNELS, PLUG_INS, WATCHING


class MemoryLevel(Level):
    """Faults in the memory of kernels and detectors."""

    fault = MemoryFault
    sampling = MemorySampling
    sampler = MemorySampler
    local = True
    can_wait = True
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
            site, what = split_site(text)
            change, bit, time_us, lasts_s = parse_fields(what, "flip")
        else:
            parts = self.parts_of(text)
            site = parts.site
            bit = parts.options.get("bit")
            time_us = parts.time_us
            lasts_s = parts.options.get("lasts", 0.0)
        kernel, _, name = site.partition(".")
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
            return f"{fault.site}:{fault.change.with_fields(fault.bit, fault.time_us, fault.lasts_s)}"
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

    def inject(self, loop: Any, fault: MemoryFault, detector: Any) -> Injector:
        """See `Level.inject`."""
        from mavfi.levels.memory.injector import MemoryInjector

        injector = loop.taps.injector = MemoryInjector(loop, fault, detector)
        return injector

    def wait(self, loop: Any, fault: MemoryFault, detector: Any) -> Begin:
        """See `Level.wait`: the node of the kernel may be restarted with messages from before the event."""
        from mavfi.levels.memory.injector import MemoryInjector

        injector = MemoryInjector(loop, replace(fault, time_us=NO_SITE), detector)

        def begin(_: Any, time_us: int) -> Injector:
            injector.begin(time_us)
            return injector

        return begin

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
