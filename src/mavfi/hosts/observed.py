"""Coupling `observer`: the detector is a subscriber, as the paper's node, and what it asks for is done one step later.

A value has been seen by its consumers when the alarm comes.  So a recomputation takes the memory of the kernel back to
before the step that was complained about, and the next step gives the value that replaces it: at the next control
period for planning and control, with the next image's turn for perception, with the next sample of the IMU for the
state estimator.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from mavfi.detectors.detector import Alarm, Detector
from mavfi.faults.fault import Fault
from mavfi.hosts.inprocess import Flight, Host, Redo, stage_of
from mavfi.mission import Scenario
from mavfi.pipeline.functions import PLAIN, KernelFunctions
from mavfi.pipeline.kernel import Kernel
from mavfi.platforms.compute import STAGE_KERNELS, redo_latency, stage_latency
from mavfi.states import Stage, State

_ON_DEMAND = ("planner", "trajectory")


@dataclass(frozen=True, slots=True)
class _Request:
    alarm: Alarm
    stage: Stage


class ObservedHost(Host):
    """One flight with a detector beside the consumers; arguments as of `Host`."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.requests: dict[str, _Request] = {}

    def deliver(self, state: State, now: int) -> None:
        """A value on its way to its consumers; the detector sees it with them."""
        if self.injector is not None:
            state = self.injector(state, now)
        if self.detector is not None:
            self._observe(state, now, self.detector)
        self.publish(state, now)

    def _observe(self, state: State, now: int, detector: Detector) -> None:
        redo = self.redo.pop(state.spec.name, None)
        alarm = None if redo is not None else detector.check(state, now)
        detector.accept(state, now)
        if redo is not None and self.alarms[redo.place]["action"] == "recompute":
            self.alarms[redo.place]["outcome"] = "accepted" if state.same_bits(redo.rejected) else "repaired"
        if alarm is not None:
            self._ask(alarm, state, now)

    def _ask(self, alarm: Alarm, state: State, now: int) -> None:
        """Note what a detector asks for."""
        stage, spec = stage_of(alarm), state.spec
        record = {"time_s": 1e-6 * now, **alarm.to_json(), "state": spec.name, "action": "recompute"}
        record["outcome"] = "replaced"
        self.alarms.append(record)
        if alarm.stop or alarm.abandon_waypoint:
            record["action"] = "stop" if alarm.stop else "abandon"
            self.redo["planning.waypoint"] = Redo(state, len(self.alarms) - 1)
            self.requests["waypoint"] = _Request(alarm, Stage.CONTROL)
        elif spec.writer in self.kernels and stage is spec.stage:
            self.redo[spec.name] = Redo(state, len(self.alarms) - 1)
            again = "point_cloud" if spec.writer in STAGE_KERNELS[Stage.PERCEPTION] else spec.writer
            self.requests[again] = _Request(alarm, stage)
        else:
            record["outcome"] = "accepted"
            if stage is Stage.CONTROL:
                self.requests["pid"] = _Request(alarm, stage)

    # ---- one step later ---------------------------------------------------------------------------------------------
    def capture(self, now: int) -> None:
        """Take a depth image, or use the last one once more if perception is to compute again."""
        request = self.requests.pop("point_cloud", None)
        if request is None:
            super().capture(now)
            return
        self.captured_us, self.mapped = now, False
        self.recompute_us[request.stage.value] += stage_latency(self.scenario.platform, request.stage)
        for name in STAGE_KERNELS[Stage.PERCEPTION]:
            self.kernels[name].rollback()
        self.start(self.kernels["point_cloud"], now)

    def tick(self, now: int) -> None:
        """One control period."""
        super().tick(now)
        if self.status is not None:
            return
        for name in _ON_DEMAND:
            if name in self.requests and name not in self.busy:
                self.start(self.kernels[name], now)

    def start(self, kernel: Kernel, now: int, extra_us: int | None = None) -> None:
        """Run a kernel, from the memory that it had before if that was asked for."""
        scanning = kernel.name in STAGE_KERNELS[Stage.PERCEPTION]  # asked for at the next image, see `capture`
        request = None if scanning else self.requests.pop(kernel.name, None)
        if request is None:
            super().start(kernel, now, extra_us)
            return
        charged = redo_latency(self.scenario.platform, kernel.name, request.stage)
        self.recompute_us[request.stage.value] += charged
        waypoint: Any = kernel
        if request.alarm.stop or request.alarm.abandon_waypoint:
            kernel.mark()
            self.finish(kernel, waypoint.stop() if request.alarm.stop else waypoint.abandon(now), now, charged)
            return
        kernel.rollback()
        super().start(kernel, now, charged)


def fly_observed(
    scenario: Scenario, fault: Fault | None, detector: Detector, functions: KernelFunctions = PLAIN
) -> Flight:  # fmt: skip
    """Fly one mission with the detector as an observer.

    Args:
        scenario: The mission.
        fault: What to inject; None = golden flight.
        detector: What watches.
        functions: What the kernels call.

    Returns:
        The flight; the same arguments give the same bytes.
    """
    with np.errstate(all="ignore"):
        return ObservedHost(scenario, fault, detector, functions=functions).fly()
