"""Flights on real ROS, with one process for each node.  They are those of one process."""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import pytest

from mavfi.cli import run
from mavfi.errors import MachineError, MavfiError
from mavfi.extras.ros.cli import effect
from mavfi.extras.ros.lockstep.folder import PID
from mavfi.extras.ros.lockstep.host import fly as fly_there
from mavfi.extras.ros.lockstep.register_injector import fault_in_node
from mavfi.extras.ros.processes import is_alive
from mavfi.flight.compose import detector_for
from mavfi.flight.decide import RecoveryPolicy
from mavfi.flight.fly import fly as fly_here
from mavfi.levels.sensor.fault import SensorFault
from mavfi.record import FlightLog
from tests.core.flights.missions import Scripted, fault
from tests.extras.ros.lockstep.flights import NODES, plan, same, short, there
from tests.extras.ros.lockstep.needs import any_ros, each_distribution

pytestmark = [*any_ros, pytest.mark.slow]


def detector(name, scenario):
    return detector_for(scenario, name, "paper")[0]


def left_behind(folder):
    """Processes that belong to the flight with that folder."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cwd"):
        try:
            if os.readlink(path).startswith(str(folder)) and is_alive(int(path.parent.name)):
                found.append(path.parent.name)
        except OSError:
            pass
    return found


def test_a_flight_with_a_state_fault():
    wrong = fault("planning.waypoint", "x", 4.0, 55)
    scenario = short(autopilot="hardened")
    log = there(scenario, wrong)
    same(log, fly_here(scenario, wrong).log)
    assert log.injections[0].activated
    assert log.digest() != fly_here(scenario).log.digest()


@pytest.mark.parametrize(
    ("failure", "options"),
    [
        (SensorFault("motor", "slow", 3_000_000, instance=2), {}),
        pytest.param(
            SensorFault("depth_camera", "garbage", 2_000_000, 1.5, seed=4),
            {"localization": "estimator"},
            marks=pytest.mark.long,
        ),
    ],
)
def test_a_sensor_or_motor_fails_as_in_one_process(failure, options):
    scenario = short(**options)
    log = there(scenario, failure)
    same(log, fly_here(scenario, failure).log)
    assert log.injections[0].activated
    assert log.digest() != fly_here(scenario).log.digest()


@each_distribution
def test_a_flight_with_a_fault_and_a_detector(ros):
    scenario, name = short(), "gaussian"
    wrong = fault("planning.waypoint", "x", 4.0, 62)
    log = there(scenario, wrong, detector(name, scenario), ros=ros)
    same(log, fly_here(scenario, wrong, detector(name, scenario)).log)
    assert log.alarms


@pytest.mark.long
def test_an_injected_estimate_violates_its_rule():
    scenario, observer = short(localization="estimator"), RecoveryPolicy("observer")
    wrong = fault("perception.odometry", "x", 3.0, 62)
    log = there(scenario, wrong, detector("acceptance", scenario), recovery=observer)
    same(log, fly_here(scenario, wrong, detector("acceptance", scenario), recovery=observer).log)
    assert log.injections[0].activated
    assert (log.alarms[0].fields, log.alarms[0].action) == (("perception.odometry.x",), "recompute")


def test_a_killed_node_comes_back_and_the_flight_continues(capsys, tmp_path):
    saved = tmp_path / "flight.npz"
    options = ["--seed", "7", "--goal", "16", "0", "3", "--kill", "octomap@2", "--json", "--save", str(saved)]
    assert run(["ros", "fly", *options]) == 0
    data = json.loads(capsys.readouterr().out)
    lost, back = data["ros"]["lives"]
    assert (lost["event"], lost["node"], lost["time_s"]) == ("node_lost", "octomap", 2.0)
    assert (back["event"], back["node"], back["time_s"]) == ("node_back", "octomap", 3.0)
    assert data["status"] == "success"
    assert data["ros"]["nodes"] == list(NODES)
    log = FlightLog.load(saved)
    assert log.digest() == data["digest"]
    # between its death and its return no map was made
    gap = [event.time_us for event in log.events if event.kind.startswith("node")]
    assert gap == [2_000_000, 3_000_000]


LIVES = [("node_lost", "detector"), ("node_back", "detector")]
"""What becomes of a detector that dies, or hangs, once."""


def lives(log):
    return [(event.kind, event.data["node"]) for event in log.events if event.kind.startswith("node")]


def test_a_detector_that_dies_blocks_nothing_until_it_is_back():
    """The flight is the one without a detector, here, bit for bit."""
    wrong = fault("planning.waypoint", "x", 2.2, 40)
    log = there(short(), wrong, Scripted(), kills=(("detector", 2_000_000),))
    assert lives(log) == LIVES
    same(
        replace(log, events=[event for event in log.events if not event.kind.startswith("node")]),
        fly_here(short(), wrong).log,
    )


class Hanging(Scripted):
    """A detector that does not come back from one call."""

    def check(self, state, time_us):
        if state.spec.name == "control.command" and 1_000_000 < time_us < 1_100_000:
            time.sleep(3600)


def test_a_hung_node_is_ended_and_restarted():
    fly_here(short())  # what is compiled at its first use must not look like hanging
    log = there(short(), None, Hanging(), patience_s=8.0)
    assert lives(log) == LIVES
    moment = log.column("time")
    assert len(set(log.column("command_vx")[(moment > 1.2) & (moment < 1.9)])) > 1, "it blocks nothing"


def test_time_passes_as_on_the_wall_if_wanted():
    scenario = short()
    flight = fly_there(plan(scenario, pace=2.0))
    same(flight.flight.log, fly_here(scenario).log)
    assert flight.times["flight"] >= 0.45 * flight.flight.log.column("time")[-1]


def test_a_fault_in_a_register_of_a_node():
    scenario = short()
    # On a busy machine the tracer may attach only after a flight of five seconds; in a slow one the node mostly waits.
    for pace in (1.0, 0.3, 1.0, 0.3):
        planned = plan(scenario, register_faults=(fault_in_node("pid", 500_000),), pace=pace)
        log = fly_there(planned).flight.log
        (injection,) = log.injections
        if injection.activated:
            break
    assert injection.activated and injection.details["node"] == "pid", injection
    assert int(injection.before, 16) ^ int(injection.after, 16) == 1 << injection.bit
    expected = ("crash", "hang")
    if not lives(log):
        expected = ("masked",) if log.digest() == fly_here(scenario).log.digest() else ("sdc",)
    assert effect(planned, log) in expected


@pytest.mark.slow
def test_a_flight_whose_processes_are_killed_is_a_failure_of_the_machine():
    def kill(folder):
        os.kill(int((folder / PID).read_text()), signal.SIGKILL)

    before = set(Path(tempfile.gettempdir()).glob("mavfi-ros-*"))
    scenario = short()
    with pytest.raises(MachineError, match="^ROS: the process that starts the nodes was killed$"):
        fly_there(plan(scenario), tell=kill)
    assert set(Path(tempfile.gettempdir()).glob("mavfi-ros-*")) <= before


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGKILL])
def test_no_process_is_left_behind(sent, tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-m", "mavfi", "ros", "fly", "--seed", "7"],
        env={**os.environ, "TMPDIR": str(tmp_path)},
        stderr=subprocess.PIPE,
        text=True,
    )
    until = time.monotonic() + 120
    while not (logs := list(tmp_path.glob("mavfi-ros-*/log/pid.out"))) and time.monotonic() < until:
        time.sleep(0.05)
    folder = logs[0].parents[1]
    assert len(left_behind(folder)) > 3
    process.send_signal(sent)
    _, stderr = process.communicate(timeout=30)
    assert sent == signal.SIGKILL or (process.returncode, stderr.count("\n")) == (130, 1)
    until = time.monotonic() + 20
    while (left_behind(folder) or folder.exists()) and time.monotonic() < until:
        time.sleep(0.05)
    assert left_behind(folder) == []
    assert not folder.exists()


def test_a_flight_that_fails_says_where_to_look(capsys, tmp_path, monkeypatch):
    from mavfi.extras.ros.lockstep import host as session

    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    monkeypatch.setattr(session.sys, "executable", "/bin/false")
    assert run(["ros", "fly"]) == 1
    text = capsys.readouterr().err
    assert text.count("\n") == 1 and "logs: " in text


class Crashing(Scripted):
    """A detector that fails once in its first life."""

    def check(self, state, time_us):
        if state.spec.name == "control.command" and 1_000_000 < time_us < 1_100_000:
            raise ZeroDivisionError


def test_a_node_whose_code_fails_dies_and_is_restarted():
    assert lives(there(short(), None, Crashing())) == LIVES


def test_when_the_world_fails_so_does_the_flight(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with pytest.raises(MavfiError, match=r"ROS: the flight failed: .*stage 'propulsion'.*; logs: "):
        there(short(), None, Scripted("control.command", n=10, stage="propulsion"))
