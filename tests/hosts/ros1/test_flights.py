"""Flights on real ROS: roscore, roslaunch, one process for each node.  In lock-step they are those of one process."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest

from mavfi.cli import run
from mavfi.detectors.detector import Chain
from mavfi.errors import MavfiError
from mavfi.faults.sensor.fault import SensorFault
from mavfi.flight_log import FlightLog
from mavfi.hosts.local import fly as fly_here
from mavfi.hosts.loop.policy import Recovery
from mavfi.hosts.loop.recovery import MOST_UNCHANGED
from mavfi.hosts.ros1.plan import Plan
from mavfi.hosts.ros1.roll_call import is_alive
from mavfi.hosts.ros1.session import configure
from mavfi.hosts.ros1.session import fly as fly_there
from mavfi.hosts.watching import detector_for
from tests.hosts.missions import Scripted, fault, golden, mission
from tests.hosts.ros1.flights import NODES, same, short, there
from tests.hosts.ros1.needs import ros

pytestmark = [*ros, pytest.mark.slow]


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


@pytest.mark.long
def test_a_golden_flight():
    """As is the one of `test_campaign`."""
    same(there(mission()), golden().log)


def test_nodes_that_are_new_interpreters_fly_the_same_flight():
    """All other flights of these tests are flown by forks of one process."""
    same(there(short(), forked=False), fly_here(short()).log)


def test_a_forked_node_is_a_process_of_its_own():
    """With a name, a command line and a session, and a child of roslaunch."""
    seen = {}

    def look(folder):
        thread = threading.Thread(target=lambda: seen.update(nodes_of(folder)))
        thread.start()
        threads.append(thread)

    threads = []
    scenario = short()
    fly_there(Plan(scenario, configure(scenario)), tell=look)
    threads[0].join()
    assert set(seen) == {*NODES, "world"}
    assert len({process["session"] for process in seen.values()}) == len(seen)
    for node, process in seen.items():
        assert process["command"][1:4] == ["-m", "mavfi.hosts.ros1.node", node]
        assert f"__name:={node}" in process["command"]
        assert process["parent"] == "roslaunch"


def nodes_of(folder):
    """What /proc says of the nodes of a flight, by their names."""
    found = {}
    until = time.monotonic() + 60
    while len(found) < len(NODES) + 1 and time.monotonic() < until:
        for path in Path("/proc").glob("[0-9]*"):
            try:
                name = (path / "comm").read_text().strip()
                stat = (path / "stat").read_text().rpartition(")")[2].split()
                if name in (*NODES, "world") and f"{folder}/" in (path / "cmdline").read_text():
                    found[name] = {
                        "session": int(stat[3]), "parent": Path(f"/proc/{stat[1]}/comm").read_text().strip(),
                        "command": (path / "cmdline").read_text().rstrip("\0").split("\0"),
                    }  # fmt: skip
            except OSError:
                pass
        time.sleep(0.02)
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
        (SensorFault("depth_camera", "garbage", 2_000_000, 1.5, seed=4), {"localization": "estimator"}),
        pytest.param(SensorFault("gyro", "wrong", 3_000_000), {}, marks=pytest.mark.long),
        pytest.param(
            SensorFault("position", "drift", 1_000_000), {"localization": "estimator"}, marks=pytest.mark.long
        ),
    ],
)
def test_a_sensor_or_motor_fails_as_in_one_process(failure, options):
    scenario = short(**options)
    log = there(scenario, failure)
    same(log, fly_here(scenario, failure).log)
    assert log.injections[0].activated
    assert log.digest() != fly_here(scenario).log.digest()


@pytest.mark.parametrize("name", ["gaussian", pytest.param("autoencoder", marks=pytest.mark.long)])
def test_a_flight_with_a_fault_and_a_detector_as_a_gate(name):
    scenario = short()
    wrong = fault("planning.waypoint", "x", 4.0, 62)
    log = there(scenario, wrong, detector(name, scenario))
    same(log, fly_here(scenario, wrong, detector(name, scenario)).log)
    assert log.alarms


@pytest.mark.long
def test_a_flight_with_other_options_of_a_mission():
    """Planner, map, wind, vehicle and speed reach the nodes."""
    scenario = short(planner="rrt", map="octree", wind=1.0, v_max=2.0, autopilot="hardened")
    same(there(scenario), fly_here(scenario).log)


@pytest.mark.long
def test_a_flight_with_a_fault_and_an_observer():
    """As is the one with an injected estimate."""
    scenario = short()
    wrong = fault("planning.waypoint", "x", 4.0, 62)
    log = there(scenario, wrong, detector("gaussian", scenario), recovery=Recovery("observer"))
    same(log, fly_here(scenario, wrong, detector("gaussian", scenario), recovery=Recovery("observer")).log)
    assert log.alarms


@pytest.mark.long
def test_a_flight_with_the_state_estimator():
    """As is the next one, without the fault."""
    scenario = short(localization="estimator")
    log = there(scenario)
    same(log, fly_here(scenario).log)
    assert log.digest() != fly_here(short()).log.digest()
    assert log.meta["publications"]["perception.odometry"] > 1000


@pytest.mark.parametrize("coupling", ["observer", pytest.param("inline", marks=pytest.mark.long)])
def test_an_injected_estimate_violates_its_rule(coupling):
    scenario = short(localization="estimator")
    wrong = fault("perception.odometry", "x", 3.0, 62)
    log = there(scenario, wrong, detector("acceptance", scenario), recovery=Recovery(coupling))
    same(log, fly_here(scenario, wrong, detector("acceptance", scenario), recovery=Recovery(coupling)).log)
    assert log.injections[0].activated
    assert (log.alarms[0].fields, log.alarms[0].action) == (("perception.odometry.x",), "recompute")


def test_every_kind_of_recovery():
    """Of a stage, by the setpoint generator, and of a stage that did not write what raised the alarm."""

    def several():
        return Chain(
            Scripted("perception.collision_status", n=5, stage="perception"),
            Scripted("control.command", n=130, stop=True),
            Scripted("planning.waypoint", n=4, stage="control"),
        )

    log = there(short(), None, several())
    same(log, fly_here(short(), None, several()).log)
    assert [alarm.action for alarm in log.alarms].count("recompute") == 2
    assert len(log.alarms) == 3


def test_an_injector_that_was_killed_does_not_inject_again():
    wrong = fault("control.command", "vy", 1.0, 3)
    log = there(short(), wrong, kills=(("injector", 2_000_000),))
    assert log.injections == fly_here(short(), wrong).log.injections
    assert [event.kind for event in log.events if event.kind.startswith("node")] == ["node_lost", "node_back"]


def test_a_killed_node_comes_back_and_the_flight_continues(capsys, tmp_path):
    saved = tmp_path / "flight.npz"
    assert run(["ros", "fly", "--seed", "7", "--kill", "octomap@6", "--json", "--save", str(saved)]) == 0
    data = json.loads(capsys.readouterr().out)
    lost, back = data["ros"]["lives"]
    assert (lost["event"], lost["node"], lost["time_s"]) == ("node_lost", "octomap", 6.0)
    assert (back["event"], back["node"], back["time_s"]) == ("node_back", "octomap", 7.0)
    assert data["status"] == "success"
    assert data["ros"]["nodes"] == list(NODES)
    log = FlightLog.load(saved)
    assert log.digest() == data["digest"]
    # between its death and its return no map was made
    gap = [event.time_us for event in log.events if event.kind.startswith("node")]
    assert gap == [6_000_000, 7_000_000]


LIVES = [("node_lost", "detector"), ("node_back", "detector")]
"""What becomes of a gate that dies, or hangs, once."""


def lives(log):
    return [(event.kind, event.data["node"]) for event in log.events if event.kind.startswith("node")]


@pytest.mark.parametrize("wrong", [None, fault("planning.waypoint", "x", 2.2, 40)], ids=["golden", "with an injector"])
def test_a_gate_that_dies_is_bypassed_until_it_is_back(wrong):
    """The flight is the one without a detector, here, bit for bit."""
    log = there(short(), wrong, Scripted(), kills=(("detector", 2_000_000),))
    assert lives(log) == LIVES
    same(replace(log, events=[event for event in log.events if not event.kind.startswith("node")]),
         fly_here(short(), wrong).log)  # fmt: skip


def test_a_node_that_returns_while_the_gate_is_down_bypasses_it_as_well():
    """The gate's next process is there before its return counts, and would hold back every way-point."""
    alarming = Scripted("planning.waypoint", n=1, stage="planning", times=10**6)
    log = there(short(), None, alarming, kills=(("waypoint", 1_500_000), ("detector", 2_000_000)))
    assert lives(log) == [("node_lost", "waypoint"), LIVES[0], ("node_back", "waypoint"), LIVES[1]]


def test_alarms_without_end_get_a_few_recomputations_as_here():
    alarming, limit = Scripted("control.command", times=10**6), Recovery(same_twice="limit")
    log = there(short(), None, alarming, recovery=limit)
    assert len(log.alarms) == MOST_UNCHANGED * (1 + int(log.column("time")[-1] // 10))
    same(log, fly_here(short(), detector=alarming, recovery=limit).log)


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


@pytest.mark.alone
@pytest.mark.parametrize("detector, kills", [(Hanging(), ()), (Scripted(), (("detector", 2_000_000),))])
def test_a_free_running_flight_bypasses_a_gate_that_hangs_or_dies(detector, kills):
    log = there(short(), None, detector, recovery=Recovery(same_twice="limit"), kills=kills, free_running=True)
    assert lives(log) == LIVES
    lost, back = (1e-6 * event.time_us for event in log.events if event.kind.startswith("node"))
    moment = log.column("time")
    assert len(set(log.column("command_vx")[(moment > lost + 0.1) & (moment < back)])) > 1, "commands arrive"


@pytest.mark.alone
def test_time_passes_as_on_the_wall_if_wanted():
    scenario = short()
    alarming = Scripted("control.command", n=150)
    plan = Plan(
        scenario, configure(scenario), fault("control.command", "vy", 2.0, 3), alarming, Recovery(same_twice="limit"),
        free_running=True,
    )  # fmt: skip
    flight = fly_there(plan)
    log = flight.flight.log
    assert log.status.label in ("success", "timeout", "collision")  # the machine may be slow
    assert flight.times["flight"] == pytest.approx(log.column("time")[-1], abs=2.0)
    assert log.injections[0].activated
    assert [alarm.state for alarm in log.alarms] == ["control.command"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL], ids=["ctrl-c", "kill -9"])
def test_no_process_is_left_behind(number, tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-m", "mavfi", "ros", "fly", "--seed", "7"], env={**os.environ, "TMPDIR": str(tmp_path)},
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    until = time.monotonic() + 60
    while not (folders := list(tmp_path.glob("mavfi-ros-*/log/*/world*.log"))) and time.monotonic() < until:
        time.sleep(0.05)
    folder = folders[0].parents[2]
    assert len(left_behind(folder)) > 3
    process.send_signal(number)
    _, stderr = process.communicate(timeout=30)
    assert number == signal.SIGKILL or (process.returncode, stderr.count("\n")) == (130, 1)
    until = time.monotonic() + 20
    while (left_behind(folder) or folder.exists()) and time.monotonic() < until:
        time.sleep(0.05)
    assert left_behind(folder) == []
    assert not folder.exists()


def test_a_flight_that_fails_says_where_to_look(capsys, tmp_path, monkeypatch):
    from mavfi.hosts.ros1 import session

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
