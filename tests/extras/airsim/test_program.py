"""Client programs with the real client library (Cosys-AirSim's), unmodified, in simulated time."""

import hashlib
import importlib.util
import json
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mavfi.errors import BadInputError
from mavfi.extras.airsim.boundary import Boundary, parse_fault
from mavfi.extras.airsim.cameras import PERSPECTIVE, SKY, view
from mavfi.extras.airsim.config import ProgramConfig
from mavfi.extras.airsim.host import AirsimProgramHost, ProgramInput, client_version, effect_on, make_api, run_program
from mavfi.mission import MissionSpec
from mavfi.plugins import allow_typed
from mavfi.record import Injection
from tests.night import at_night

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("cosysairsim") is None, reason="needs the package cosysairsim (extra dev)"
)
PROGRAMS = Path(__file__).with_name("programs")
EXAMPLES = Path(__file__).parents[3] / "examples" / "airsim"
SPEC = MissionSpec(environment="sparse", seed=7)


def run(path, *arguments, fault=None, standard_input=None, **options):
    program = ProgramConfig(script=str(path), arguments=arguments, **options)
    return run_program(program, SPEC, Boundary.of(None if fault is None else parse_fault(fault)), standard_input)


@pytest.fixture(scope="module")
def box():
    return run(EXAMPLES / "box.py")


def test_a_program_goes_through_the_api():
    ended = run(PROGRAMS / "everything.py")
    assert (ended.how, ended.reason) == ("ended", "")
    results = json.loads(ended.output.splitlines()[-1])
    ranges = view(make_api(SPEC), "0", PERSPECTIVE).ranges
    expected_ranges = np.where(np.isfinite(ranges), ranges, np.float32(SKY))
    assert results.pop("depth") == hashlib.sha256(expected_ranges.tobytes()).hexdigest()
    assert np.abs(np.array(results.pop("at")) - (0, 4, -4)).max() < 0.5
    assert results.pop("imu") == pytest.approx(-9.80665, abs=0.2) and results.pop("lidar") > 3000
    assert results.pop("slept") == pytest.approx(1.5, abs=0.02)
    assert len(results.pop("seen")) == 64
    assert "API control is off" in results.pop("refused")
    assert results == {
        "version": client_version("", __file__),
        "size": [256, 144],
        "takeoff": True,
        "state": 1,
        "position": True,
        "path": True,
        "collided": False,
        "continued": 500_000_000,
        "paused": True,
        "cancelled": False,
        "api": False,
        "hit": "wall",
    }
    assert ended.collided  # also after a reset


def test_the_same_program_with_the_same_seed_has_the_same_bytes(box):
    again = run(EXAMPLES / "box.py")
    assert (again.digest, again.output, again.calls, again.seconds) == (box.digest, box.output, box.calls, box.seconds)
    assert box.how == "ended" and not box.collided and "no collision" in box.output


@pytest.mark.parametrize(("name", "arguments"), [("survey", ("6", "2")), ("orbit", ("0.3",))])
def test_programs_in_the_style_of_airsim_s_examples_fly(name, arguments):
    ended = run(EXAMPLES / f"{name}.py", *arguments)
    assert (ended.how, ended.collided, ended.errors) == ("ended", False, {}) and ended.seconds > 10.0


@pytest.mark.parametrize(
    ("fault", "effect"),
    [
        ("simGetVehiclePose.return.position.x_val:bit=51", "masked"),  # the program prints it only
        ("moveToPosition.x:bit=51", "deviates"),
        *at_night(
            ("moveToPosition.yaw_mode.none:bit=51", "not activated"),
            ("armDisarm.arm:bit=0", "deviates"),  # the motors stay off
            ("sensor:depth_camera:off@3", "not activated"),  # the program takes no image
        ),
        ("sensor:position:wrong@3", "deviates"),
    ],
)
def test_what_a_fault_does_to_a_program(box, fault, effect):
    injected = run(EXAMPLES / "box.py", fault=fault)
    assert effect_on(box, injected) == effect
    assert (injected.boundary.injected is not None) == (effect != "not activated")


@pytest.mark.parametrize(("location", "module"), [("beside", "airsim/notes.txt"), ("working", "airsim.py")])
def test_a_folder_named_airsim_is_not_taken_for_the_library(tmp_path, monkeypatch, location, module):
    script, other = tmp_path / "short.py", tmp_path / ("" if location == "beside" else "work") / module
    other.parent.mkdir(parents=True, exist_ok=True)
    other.write_text("")
    script.write_text("import airsim\nprint(airsim.MultirotorClient().ping())\n")
    monkeypatch.chdir(tmp_path if location == "beside" else tmp_path / "work")
    ended = run(script)
    assert (ended.how, ended.reason, ended.output) == ("ended", "", "True\n")


def test_the_worst_that_a_fault_does_comes_first(box):
    hit = Boundary(injection=Injection("message", "moveToZ.z", 1.0, 1, 0.0, 1.0, True))
    for changes, effect in (
        ({}, "masked"),
        ({"digest": "other"}, "deviates"),
        ({"digest": "other", "collided": True}, "collision"),
        ({"how": "program crash", "collided": True}, "program crash"),
        ({"how": "hang"}, "hang"),
        ({"how": "time is up"}, "hang"),
    ):
        assert effect_on(box, replace(box, boundary=hit, **changes)) == effect
    assert effect_on(box, box) == "not activated"


@pytest.mark.parametrize(
    ("name", "arguments", "options", "how", "reason"),
    [
        ("crashing", (), {}, "program crash", "ValueError: the program's own error"),
        (
            "endless",
            ("sleep",),
            {"seconds": 20.0},
            "time is up",
            "it waited for time.sleep; more time: --seconds above 20",
        ),
        (
            "endless",
            ("pipe",),
            {"wall_s": 8.0, "seconds": 20.0},  # half of it is time for its start, on a busy machine
            "time is up",
            r"it waited for what is not simulated, or computed, since its call ping at 0.00\d s \(\d+ s of wall-clock "
            r"time\); more time: --seconds above 20",
        ),
        ("endless", ("event",), {"seconds": 20.0}, "time is up", "it waited for Event.wait; more time: .*"),
        ("endless", ("input",), {"seconds": 2.0}, "time is up", r"it waited for input\(\); more time: .*"),
    ],
)
def test_how_a_program_ends(name, arguments, options, how, reason):
    ended = run(PROGRAMS / f"{name}.py", *arguments, **options)
    assert ended.how == how and re.fullmatch(reason, ended.reason)
    assert how != "time is up" or ended.seconds == options["seconds"]
    assert not any("time is up" in text for text in ended.errors), "the end of the run is no refused call"


def test_all_waits_take_simulated_time():
    ended = run(PROGRAMS / "waits.py")
    assert (ended.how, ended.reason) == ("ended", "")
    took = json.loads(ended.output.splitlines()[-1])
    readings = took.pop("readings")
    for name, (seconds, longest, shortest, _) in took.items():
        assert seconds == pytest.approx(1.02, abs=0.04), name
        assert seconds - 0.02 < shortest <= longest <= seconds, f"{name}: the clocks agree"
    results = {name: result for name, (*_, result) in took.items() if result is not None}
    assert results == {
        "Lock.acquire": False,
        "RLock.acquire": False,
        "select": [],
        "poll object": [],
        "selector": [],
        "Event.wait": False,
        "Condition.wait": False,
        "Timer": True,
        "Queue.get": "empty",
        "Thread.join": False,
        "pool": [1.0, 0.5],
        "call_later": True,
        "wait_for": "timeout",
    }
    assert run(PROGRAMS / "waits.py").digest == ended.digest, "threads run in the same order"
    assert len(readings) == 6 and readings == sorted(readings) and readings[0] < 0.3 and readings[-1] > 1.2


@pytest.mark.parametrize(
    ("content", "lines"), [(b"first\nsecond\n", ["first", "second", "", ""]), (None, ["", "", "", ""])]
)
def test_the_standard_input_is_that_of_mavfi_again_for_each_run(tmp_path, content, lines):
    script = tmp_path / "reads.py"
    script.write_text("import airsim\nairsim.MultirotorClient().ping()\nprint([input('key? ') for _ in range(4)])\n")
    source = None
    if content is not None:
        source, writing_end = os.pipe()
        os.write(writing_end, content)
        os.close(writing_end)
    standard_input = ProgramInput(source)
    for _ in range(2):
        ended = run(script, standard_input=standard_input)
        assert (ended.how, ended.output.splitlines()[-1]) == ("ended", f"{lines}")


def test_modules_on_the_python_path_are_found(tmp_path, monkeypatch):
    (tmp_path / "lib").mkdir()
    (tmp_path / "lib" / "heights.py").write_text("height = 5\n")
    script = tmp_path / "short.py"
    script.write_text("import airsim\nfrom heights import height\nairsim.MultirotorClient().ping()\nprint(height)\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "lib"))
    assert run(script).output == "5\n"


def test_what_cannot_run_is_refused_in_one_line(tmp_path):
    with pytest.raises(BadInputError, match="/.*: is a folder; allowed: a client program of AirSim"):
        ProgramConfig(script=str(tmp_path)).check()
    without = tmp_path / "without.py"
    without.write_text("import no_such_package\n")
    with pytest.raises(BadInputError, match="made no call .*no_such_package"):
        run(without)


def test_a_vehicle_that_does_not_exist_is_refused_before_a_campaign_and_one_that_is_added_is_not(tmp_path):
    script = tmp_path / "adds.py"
    script.write_text(
        "import airsim\nclient = airsim.MultirotorClient()\n"
        "client.simAddVehicle('Late', 'simpleflight', airsim.Pose(airsim.Vector3r(0, 4, 0)), '')\n"
    )
    allow_typed(str(script))
    AirsimProgramHost(ProgramConfig(script=str(script), fault_vehicle="Late")).check()
    with pytest.raises(BadInputError, match="^--fault-vehicle: 'Nope': not known; allowed: SimpleFlight, Late$"):
        AirsimProgramHost(ProgramConfig(script=str(script), fault_vehicle="Nope")).check()


def test_dates_show_simulated_time_and_stay_what_they_are(tmp_path):
    script = tmp_path / "dates.py"
    script.write_text(
        """
import copy, datetime, pickle, socket, time
from datetime import date, datetime as moment, timezone
import airsim
client = airsim.MultirotorClient()
begin = moment.now()
time.sleep(90)
now, day, utc = moment.now(), date.today(), moment.utcnow()
assert 90 <= (now - begin).total_seconds() < 91
assert day == now.date() and day >= begin.date() and abs(moment.now(timezone.utc).timestamp() - time.time()) < 0.1
assert abs(utc.replace(tzinfo=timezone.utc).timestamp() - time.time()) < 0.1 and moment.today() > now
assert time.strftime("%Y-%m-%d") == time.strftime("%Y-%m-%d", time.localtime()) == f"{day}"
assert time.ctime() == time.asctime() and abs(time.clock_gettime(time.CLOCK_REALTIME) - time.time()) < 0.1
assert all(isinstance(value, date) for value in (now, day, moment(2020, 1, 1))) and not isinstance(day, moment)
assert issubclass(moment, date) and pickle.loads(pickle.dumps([now, day])) == copy.deepcopy([now, day])
assert repr(moment(2020, 1, 2)) == "datetime.datetime(2020, 1, 2, 0, 0)" and moment.strptime("3", "%d").day == 3
class Mine(moment):
    pass
assert type(Mine.now()) is Mine and not isinstance(now, Mine)
for _ in range(2):
    socket.socket().settimeout(1.0)
"""
    )
    ended = run(script)
    assert (ended.how, ended.reason) == ("ended", "")
    assert ended.error_output == "mavfi: socket.settimeout: takes wall-clock time, not simulated time\n"
