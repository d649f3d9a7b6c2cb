"""The pipeline with Debian's C++ nodelet as its kernel `point_cloud`: figures, deaths, faults in registers.

A flight of these tests takes about 8 s on two idle cores, and none may take more than a minute.
"""

import os
import signal
from types import SimpleNamespace

import numpy as np
import pytest

from mavfi.cli import ros_nodes, run
from mavfi.config import CameraConfig
from mavfi.errors import BadInputError
from mavfi.flight_log import Event, Injection
from mavfi.hosts.local import fly as fly_here
from mavfi.hosts.loop.compose import resolve
from mavfi.hosts.loop.policy import Recovery
from mavfi.hosts.node import nodelets
from mavfi.hosts.ros1 import finder
from mavfi.hosts.ros1.nodelet_cloud import points_of
from mavfi.hosts.ros1.pinhole import Pinhole, functions_of, projection
from mavfi.hosts.ros1.plan import Plan
from mavfi.hosts.ros1.register_injector import end_of_nodes, fault_in_node
from mavfi.hosts.ros1.roll_call import ask_foreign
from mavfi.hosts.ros1.session import configure, launch_text
from mavfi.hosts.ros1.session import fly as fly_there
from mavfi.kernels.perception.point_cloud import back_project
from mavfi.mission import MissionSpec
from mavfi.numerics.rotations import rotation_matrix
from mavfi.sim.camera import pixel_directions
from tests.hosts.missions import Scripted, fault
from tests.hosts.ros1.needs import ros

LONGEST_S = 240
NODE = "point_cloud_xyz"
CAMERA = CameraConfig()
BOUND_M = 3e-5
"""Between the points of the two kernels: four units in the last place of a float32 between 64 and 128 m."""


def absent():
    try:
        nodelets.require()
    except BadInputError as error:
        return str(error)
    return ""


flying = [*ros, pytest.mark.slow, pytest.mark.skipif(bool(absent()), reason=absent() or "is there")]


@pytest.fixture
def in_time():
    """The test ends within `LONGEST_S`, a guard against hanging; what it has started ends with it."""

    def stop(number, frame):
        raise TimeoutError(f"took more than {LONGEST_S} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(LONGEST_S)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def short(seed=8):
    """1.7 s with seed 8, 3.6 s with seed 5, in which there is time for a nodelet to fail and come back."""
    return resolve(MissionSpec(environment="dense", seed=seed, goal=(14.0, 0.0, 3.0)))


def plan(wrong=None, detector=None, seed=8, **options):
    scenario = short(seed)
    return Plan(scenario, configure(scenario), wrong, detector, cloud_node="depth_image_proc", **options)


def lives(log):
    return [(event.kind, event.data["node"], event.data.get("why")) for event in log.events if "node_" in event.kind]


def clouds(log):
    """How many were published."""
    return log.meta["publications"]["perception.point_cloud"]


# ---- figures --------------------------------------------------------------------------------------------------------
def points(project, ranges, pose):
    directions = pixel_directions(CAMERA)
    rotation = np.empty((3, 3))
    rotation_matrix(pose[3:], rotation)
    found = np.empty((len(ranges), 3), np.float32)
    project(ranges, directions, rotation, pose[:3], CAMERA.range, found)
    return found


@pytest.mark.parametrize("seed", range(20))
def test_both_kernels_give_the_same_points_but_for_rounding(seed):
    random = np.random.default_rng(seed)
    count = CAMERA.width * CAMERA.height
    ranges = random.uniform(0.1, 1.2 * CAMERA.range, count).astype(np.float32)
    ranges[::7], ranges[::11] = np.inf, np.nan
    turn = random.normal(size=4)
    pose = np.concatenate([random.uniform(-60.0, 60.0, 3), turn / np.linalg.norm(turn)])
    ours = points(back_project, ranges, pose)
    theirs = points(Pinhole(CAMERA, projection(CAMERA)).back_project, ranges, pose)
    assert np.array_equal(np.isnan(ours), np.isnan(theirs)) and np.isnan(ours).any()
    worst = np.nanmax(np.abs(ours.astype(float) - theirs))
    assert 0.0 < worst < BOUND_M


def test_points_without_a_depth_are_none():
    depth = np.full((CAMERA.height, CAMERA.width), 2.0, np.float32)
    depth[3, 5], depth[4, 6] = np.nan, np.inf
    found = projection(CAMERA)(depth)
    assert np.flatnonzero(np.isnan(found).any(axis=1)).tolist() == [3 * CAMERA.width + 5, 4 * CAMERA.width + 6]


@pytest.mark.parametrize(
    ("step", "size", "there"), [(16, 64, 4), (12, 48, 4), (16, 40, 2), (16, 0, 0), (0, 64, 0), (8, 64, 0), (16, 160, 4)]
)
def test_a_cloud_of_an_injected_node_is_read_as_far_as_it_goes(step, size, there):
    data = np.arange(size // 4, dtype="<f4").tobytes()
    found = points_of(SimpleNamespace(point_step=step, data=data), 4)
    assert found.shape == (4, 3)
    assert int((~np.isnan(found)).all(axis=1).sum()) == there
    if there:
        assert found[1].tolist() == [step // 4 + place for place in range(3)]


# ---- what is asked for ----------------------------------------------------------------------------------------------
def test_the_nodelet_is_a_node_of_the_launch_file_only_where_it_is_wanted():
    scenario = short()
    assert f'name="{NODE}"' in launch_text(plan())
    assert f'name="{NODE}"' not in launch_text(Plan(scenario, configure(scenario)))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--point-cloud-node", "pcl"], "--point-cloud-node: 'pcl': allowed: mavfi, depth_image_proc"),
        (["--register-fault", "point_cloud_xyz"], "NODE@SECONDS"),
        (["--register-fault", "point_cloud_xyz@-1"], "NODE@SECONDS"),
        (["--register-fault", "point_cloud_xyz@5"], "allowed: point_cloud, octomap"),
        (["--kill", "point_cloud_xyz@5"], "allowed: point_cloud, octomap"),
        (["--point-cloud-node", "depth_image_proc", "--kill", "nodelet@5"], NODE),
        (["--register-fault", "octomap@5", "--registers", "xmm"], "allowed: all, general, fp"),
        (["--register-fault", "octomap@5", "--register-seed", "-3"], "--register-seed"),
        (["--register-seed", "3"], "with --register-fault only"),
        (["--registers", "fp"], "with --register-fault only"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(capsys, monkeypatch, arguments, message):
    monkeypatch.setattr(finder, "missing", list)
    assert run(["ros", "fly", *arguments]) == 2
    text = capsys.readouterr().err
    assert text.count("\n") == 1 and message in text


def test_the_older_names_of_options_still_work_and_say_what_they_are_now(capsys, monkeypatch):
    monkeypatch.setattr(finder, "missing", list)
    assert run(["ros", "fly", "--strike", "nobody@5", "--strike-seed", "3"]) == 2
    first, second, third = capsys.readouterr().err.splitlines()
    assert first == "mavfi: --strike: deprecated, is now --register-fault"
    assert second == "mavfi: --strike-seed: deprecated, is now --register-seed"
    assert "no node 'nobody' in this flight" in third


def test_without_the_packages_it_says_what_to_install(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(finder, "missing", list)
    monkeypatch.setattr(nodelets, "find_file", lambda name: tmp_path / name)
    assert run(["ros", "fly", "--point-cloud-node", "depth_image_proc"]) == 2
    text = capsys.readouterr().err
    assert text.count("\n") == 1 and all(package in text for package in nodelets.PACKAGES)


@pytest.mark.parametrize(
    ("why", "activated", "end"),
    [
        ("has ended", True, "crash"),
        ("did not answer", True, "hang"),
        ("killed as planned", True, "alive"),
        (None, True, "alive"),
        ("has ended", False, None),
    ],
)
def test_what_becomes_of_an_injected_node(why, activated, end):
    injections = [Injection("register", "rax", 1e-6, 3, "0x0", "0x8", activated, details={"node": "a"})]
    events = [Event(2, "node_lost", {"node": "b", "why": "has ended"})]
    if why is not None:
        events.append(Event(3, "node_lost", {"node": "a", "why": why}))
    assert end_of_nodes(injections, events) == end


# ---- in flight ------------------------------------------------------------------------------------------------------
class TestFlights:
    pytestmark = flying

    def test_the_points_are_those_of_the_nodelet_bit_by_bit(self, in_time):
        """The record of a fault holds one coordinate before the injection: the nodelet's, not that of our kernel."""
        scenario, wrong = short(), fault("perception.point_cloud", "x", 0.4, 1, 2351)
        flown = plan(wrong)
        log = fly_there(flown).flight.log
        twin = fly_here(scenario, wrong, functions=functions_of(flown)).log
        ours = fly_here(scenario, wrong).log
        assert log.injections == twin.injections
        assert log.injections[0].before != ours.injections[0].before
        assert log.injections[0].before == pytest.approx(ours.injections[0].before, abs=BOUND_M)
        assert log.digest() == twin.digest()
        assert log.status.label == "success"

    @pytest.mark.parametrize(
        ("number", "why"), [(signal.SIGSEGV, "has ended"), (signal.SIGSTOP, "did not answer")], ids=["crash", "hang"]
    )
    def test_a_nodelet_that_fails_is_restarted_and_the_flight_continues(self, in_time, number, why):
        flown = plan(None, Sender(number), 5, recovery=Recovery("observer"), restart_us=200_000)
        log = fly_there(flown).flight.log
        assert lives(log) == [("node_lost", NODE, why), ("node_back", NODE, None)]
        lost, back = (event for event in log.events if "node_" in event.kind)
        assert back.time_us - lost.time_us == 200_000
        assert back.data["pid"] != lost.data["pid"]
        assert log.status.label == "success"
        before = lost.time_us / short(5).platform.latency_us["octomap"]  # there is no image while a map is made
        assert before + 1 < clouds(log) < clouds(fly_here(short(5)).log)

    def test_a_fault_in_its_registers_has_an_effect(self, in_time):
        flown = plan(register_faults=(fault_in_node(NODE, 100_000, "fp", 3),))
        log = fly_there(flown).flight.log
        (injection,) = log.injections
        details = injection.details
        assert injection.activated and details["node"] == NODE, injection
        assert int(injection.before, 16) ^ int(injection.after, 16) == 1 << injection.bit
        assert "libdepth_image_proc" in details["library"] and "convert" in details["symbol"]
        gone = [kind for kind, node, _ in lives(log) if node == NODE]
        digest = fly_here(short(), functions=functions_of(flown)).log.digest()
        expected = ("crash", "hang") if gone else ("masked",) if log.digest() == digest else ("sdc",)
        assert ros_nodes.to_json(flown, log)["register_effect"] in expected


class Sender(Scripted):
    """A detector that sends the nodelet a signal at the 20th command."""

    def __init__(self, number):
        super().__init__()
        self.number = number

    def check(self, state, time_us):
        if state.spec.name == "control.command":
            self.seen += 1
            if self.seen == 20:
                os.kill(ask_foreign(NODE), self.number)
