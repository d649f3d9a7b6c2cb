"""Missions flown by ROS nodes in lock-step, bit-identical to flights of the host `local`."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mavfi.errors import BadInputError, MachineError, MavfiError
from mavfi.extras.ros.lockstep import folder as files
from mavfi.extras.ros.lockstep.kernels import warm_up
from mavfi.extras.ros.lockstep.plan import FlightPlan, check_supported
from mavfi.extras.ros.lockstep.supervisor import ISOLATED
from mavfi.extras.ros.lockstep.transport import Middleware
from mavfi.extras.ros.processes import absolute_python_path, private_network
from mavfi.faults.changes import parse_text
from mavfi.flight.compose import pipeline_config, resolve
from mavfi.flight.host import ArmFlights, ArmSetup, Flight, Host
from mavfi.levels.sensor.fault import SensorFault
from mavfi.levels.state.fault import StateFault
from mavfi.mission import MissionSpec, Scenario
from mavfi.pipeline.kernel import PipelineConfig
from mavfi.record import FlightLog
from mavfi.sim.camera import pixel_directions
from mavfi.sim.environments import scenario_world

PATIENCE_S = 300.0
"""Time limit for a node's response (s, wall clock); generous, as a slow node mistaken for a hung one is killed, which
changes its flight."""


class LockstepHost(Host):
    """The host `ros2`: runs every kernel, the world, injector and detector as separate nodes of ROS 2."""

    name = "ros2"
    levels: frozenset[str] = frozenset({StateFault.level, SensorFault.level})

    def resolve(self, spec: MissionSpec) -> Scenario:
        """See `Host.resolve`; raises `BadInputError` for options that ROS does not support."""
        check_supported(spec)
        return resolve(spec)

    @classmethod
    def check_sampling(cls, sampling: Any) -> None:
        """See `Host.check_sampling`."""
        if getattr(sampling, "messages", ()) and "length" in sampling.strata:
            raise BadInputError("sampling.strata: 'length': may lose a message; allowed on ROS: bits of numbers")
        for text in getattr(sampling, "operations", ()):
            if parse_text(text).when.times != 1:
                raise BadInputError(f"sampling.operations: {text!r}: allowed on ROS: in one publication")

    def check(self) -> None:
        """See `Host.check`.

        Raises:
            BadInputError: ROS is not installed, or a private network cannot be created.
        """
        Middleware.installed().require()
        isolation()

    def mission(self, arms: Mapping[str, ArmSetup], *, fast_forward: bool = True) -> "LockstepFlights":
        """See `Host.mission`; every flight is flown in full."""
        return LockstepFlights(self, arms)


class LockstepFlights(ArmFlights):
    """The flights of one mission; see `MissionFlights`."""

    _host: LockstepHost

    def _fly(self, arm: str, fault: StateFault | SensorFault | None, *, profile: bool = False) -> Flight:
        setup = self._arms[arm]
        first = arm not in self._detectors
        plan = FlightPlan(
            Middleware.installed(),
            setup.scenario,
            configure(setup.scenario),
            fault,
            self._detector(arm),
            setup.recovery,
            patience_s=PATIENCE_S,
            profile=profile,
        )
        if first:
            # compile in advance: a detector that is compiled in its node would be mistaken for a hung one
            warm_up(plan.scenario, plan.detector, setup.recovery)
        return fly(plan).flight


# ---- one flight: its folder and private network, its processes from start to end -------------------------------------

KILLED = "ROS: the process that starts the nodes was killed"
_POLL_S = 0.02
_LAST_WORDS_S = 20.0


@dataclass(slots=True)
class RosFlight:
    """A flight on ROS, without kernels; `times` (s, wall clock): "prepare", "start" (of the nodes), "flight", "end"."""

    flight: Flight
    times: dict[str, float]


def configure(scenario: Scenario) -> PipelineConfig:
    """The kernels' configuration for a mission."""
    world = scenario_world(scenario)
    return pipeline_config(scenario, world, pixel_directions(scenario.camera))


def isolation(allow_bind_all: bool = False) -> list[str]:
    """See `private_network`; with `allow_bind_all` it may be missing, and ROS 2's discovery listens on all interfaces.

    Raises:
        BadInputError: A private network is required and cannot be created.
    """
    try:
        return private_network("as root, with user namespaces, or with --allow-bind-all")
    except BadInputError:
        if allow_bind_all:
            return []
        raise


def fly(plan: FlightPlan, *, allow_bind_all: bool = False, tell: Callable[[Path], None] | None = None) -> RosFlight:
    """Fly one mission on ROS.

    Args:
        plan: The flight.
        allow_bind_all: See `isolation`.
        tell: Called with the flight's folder once its script `join` is usable.

    Raises:
        BadInputError: ROS is not installed, or there is no private network.
        MavfiError: The flight failed; the message gives the cause and the folder of the nodes' logs.
    """
    plan.middleware.require()
    command = isolation(allow_bind_all)
    began = time.time()
    with files.new_folder() as folder:
        _prepare(plan, folder, command)
        prepared = time.time()
        _run(plan, folder, command, tell)
        flight = _result(folder, plan)
        return RosFlight(flight, _spent(folder, began, prepared))


def _prepare(plan: FlightPlan, folder: Path, command: list[str]) -> None:
    """Write all files of the flight to its folder."""
    plan.save(folder)
    (folder / files.LOG).mkdir()
    files.write_join(folder, plan.middleware, command)


def _run(plan: FlightPlan, folder: Path, command: list[str], tell: Callable[[Path], None] | None) -> None:
    """Start the supervisor, and wait until the flight and all its processes have ended.

    Raises:
        MachineError: The supervisor was killed, as no fault can.
    """
    program = [*command, sys.executable, "-m", "mavfi.extras.ros.lockstep.supervisor", str(os.getpid())]
    if command:
        program.append(ISOLATED)
    variables = {**files.environment(folder, plan.middleware), "PYTHONPATH": absolute_python_path()}
    with (folder / files.LOG / "supervisor.out").open("wb") as output:
        supervisor = subprocess.Popen(
            program,
            env=variables,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            cwd=folder,
            start_new_session=True,
        )
    try:
        while supervisor.poll() is None:
            if tell is not None and (folder / files.PID).exists():
                tell(folder)
                tell = None
            time.sleep(_POLL_S)
    finally:
        _end(supervisor)
    if supervisor.returncode < 0:
        raise MachineError(KILLED)


def _end(supervisor: "subprocess.Popen[bytes]") -> None:
    """End a supervisor that still runs; it ends all others first."""
    if supervisor.poll() is not None:
        return
    supervisor.terminate()
    try:
        supervisor.wait(_LAST_WORDS_S)
    except subprocess.TimeoutExpired:
        supervisor.kill()
        supervisor.wait()


def _result(folder: Path, plan: FlightPlan) -> Flight:
    """The flight record of the world; `MavfiError` if there is none."""
    failure = folder / files.FAILURE
    if failure.exists():
        raise MavfiError(f"ROS: the flight failed: {failure.read_text().strip().splitlines()[-1]}")
    if not (folder / files.FLIGHT).exists():
        raise MavfiError("ROS: the flight ended without a record")
    scenario = plan.scenario
    world = scenario_world(scenario)
    profile = None
    if plan.profile:
        profile = files.read_profile(folder)
    return Flight(FlightLog.load(folder / files.FLIGHT), profile, world)


def _spent(folder: Path, began: float, prepared: float) -> dict[str, float]:
    """Wall-clock time by phase (s)."""
    times = json.loads((folder / files.TIMES).read_text())
    return {
        "prepare": prepared - began,
        "start": times["nodes_ready"] - prepared,
        "flight": times["flight_done"] - times["nodes_ready"],
        "end": time.time() - times["flight_done"],
    }
