"""Flies a mission on ROS from the outside: a private folder, a private network, every process, and their end."""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mavfi.errors import BadInputError, MavfiError
from mavfi.flight_log import FlightLog, Profile
from mavfi.hosts.host import Flight
from mavfi.hosts.loop.compose import pipeline_config
from mavfi.hosts.node import nodelets
from mavfi.hosts.ros1 import finder
from mavfi.hosts.ros1.folder import (
    DEFINITIONS,
    FAILURE,
    FLIGHT,
    FOLDER_VARIABLE,
    LOG,
    MESSAGES,
    PID,
    PROFILE,
    TIMES,
    free_port,
    own_path,
    write_join,
)
from mavfi.hosts.ros1.generate import generate, name_definitions
from mavfi.hosts.ros1.launch import write_package
from mavfi.hosts.ros1.plan import Plan
from mavfi.mission import Scenario
from mavfi.pipeline.kernel import PipelineConfig
from mavfi.sim.camera import pixel_directions
from mavfi.sim.environments import build_world

_POLL_S = 0.02
_LAST_WORDS_S = 20.0


@dataclass(slots=True)
class RosFlight:
    """What a flight on ROS gives.

    Attributes:
        flight: The record, as of any host; without kernels.
        times: Where the wall-clock time went (s): "prepare", "start" (master and nodes), "flight", "end".
    """

    flight: Flight
    times: dict[str, float]


def configure(scenario: Scenario) -> PipelineConfig:
    """What the kernels of a mission are told."""
    world = build_world(scenario.environment, scenario.seed, scenario.start, scenario.goal)
    return pipeline_config(scenario, world, pixel_directions(scenario.camera))


def isolation(allow_bind_all: bool = False) -> list[str]:
    """Command that gives a program a private network, in which nothing outside can reach it.

    Args:
        allow_bind_all: Go without where it cannot be had: ROS's C++ nodes then listen on all interfaces.

    Raises:
        BadInputError: It cannot be had.
    """
    for command in (["unshare", "-n"], ["unshare", "-Urn"]):
        try:
            if subprocess.run([*command, "true"], capture_output=True, check=False).returncode == 0:
                return command
        except OSError:
            break
    if allow_bind_all:
        return []
    raise BadInputError(
        "no private network: neither `unshare -n` nor `unshare -Urn` works here, and ROS's C++ nodes listen on all "
        "interfaces; allowed: as root, with user namespaces, or with --allow-bind-all"
    )


def fly(
    plan: Plan, *, allow_bind_all: bool = False, tell: Callable[[Path], None] | None = None
) -> RosFlight:  # fmt: skip
    """Fly one mission on ROS.

    Args:
        plan: The flight.
        allow_bind_all: See `isolation`.
        tell: Is told the folder of the flight as soon as the script `join` in it can be run.

    Raises:
        BadInputError: ROS is not installed; no private network.
        MavfiError: The flight failed; the text says how, and where the nodes' logs are.
    """
    finder.require()
    if plan.foreign:
        nodelets.require()
    command = isolation(allow_bind_all)
    began = time.time()
    folder = Path(tempfile.mkdtemp(prefix="mavfi-ros-"))
    try:
        _prepare(plan, folder, command)
        prepared = time.time()
        _run(folder, command, tell)
        flight = _result(folder, plan)
        times = _spent(folder, began, prepared)
    except MavfiError as error:
        raise MavfiError(f"{error}; logs: {folder / LOG}") from None
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    shutil.rmtree(folder, ignore_errors=True)
    return RosFlight(flight, times)


def _prepare(plan: Plan, folder: Path, command: list[str]) -> None:
    """Everything that the flight needs, in its folder."""
    finder.enable(folder / MESSAGES)
    generate(folder / MESSAGES)
    name_definitions(folder / DEFINITIONS)
    plan.save(folder)
    write_package(plan, folder)
    (folder / LOG).mkdir()
    if not command:
        os.environ.update(free_port())
    write_join(folder, bool(command), "-Urn" in command)


def _run(folder: Path, command: list[str], tell: Callable[[Path], None] | None) -> None:
    """Start the supervisor, and wait for the flight's end and that of all its processes."""
    variables = {**os.environ, "PYTHONPATH": own_path(), FOLDER_VARIABLE: str(folder)}
    with (folder / LOG / "supervisor").open("wb") as log:
        supervisor = subprocess.Popen(
            [*command, sys.executable, "-m", "mavfi.hosts.ros1.supervisor"], env=variables, stdout=log, stderr=log,
            stdin=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
    try:
        told = tell is None
        while supervisor.poll() is None:
            if not told and (folder / PID).exists():
                told = True
                assert tell is not None
                tell(folder)
            time.sleep(_POLL_S)
    finally:
        if supervisor.poll() is None:
            supervisor.send_signal(signal.SIGTERM)
            supervisor.wait(_LAST_WORDS_S)


def _result(folder: Path, plan: Plan) -> Flight:
    """The record that the world has left.

    Raises:
        MavfiError: It has left none.
    """
    failure = folder / FAILURE
    if failure.exists():
        raise MavfiError(f"ROS: the flight failed: {failure.read_text().strip().splitlines()[-1]}")
    if not (folder / FLIGHT).exists():
        raise MavfiError("ROS: the flight ended without a record")
    scenario = plan.scenario
    world = build_world(scenario.environment, scenario.seed, scenario.start, scenario.goal)
    profile = Profile.from_bytes((folder / PROFILE).read_bytes()) if plan.profile else None
    return Flight(FlightLog.load(folder / FLIGHT), profile, world)


def _spent(folder: Path, began: float, prepared: float) -> dict[str, float]:
    """Where the wall-clock time went (s)."""
    told = json.loads((folder / TIMES).read_text())
    return {
        "prepare": prepared - began, "start": told["nodes_ready"] - prepared,
        "flight": told["flight_done"] - told["nodes_ready"], "end": time.time() - told["flight_done"],
    }  # fmt: skip
