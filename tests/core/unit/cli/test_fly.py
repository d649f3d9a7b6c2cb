import json
import struct

import pytest

from mavfi.cli import run
from mavfi.record import FlightLog


def _fly(capsys, *arguments):
    assert run(["fly", "--environment", "sparse", "--seed", "7", "--json", *arguments]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.fixture(scope="module")
def golden_digest():
    from mavfi.flight.compose import resolve
    from mavfi.flight.fly import fly
    from mavfi.mission import MissionSpec

    return fly(resolve(MissionSpec(environment="sparse", seed=7))).log.digest()


def test_json_has_what_is_promised(capsys, golden_digest):
    data = _fly(capsys)
    assert data["status"] == "success"
    assert data["digest"] == golden_digest
    assert 25 < data["flight_time_s"] < 60
    assert data["energy_j"] > 5_000
    assert 80 < data["distance_m"] < 200
    assert data["injections"] == [] and data["alarms"] == []
    assert data["replans"] == data["events"]["plan"] - 1 > 0
    assert (data["environment"], data["seed"], data["autopilot"]) == ("sparse", 7, "published")
    assert data["golden"] is None and data["effect"] is None


@pytest.mark.slow
def test_a_named_fault_is_recorded_with_proof(capsys, golden_digest):
    data = _fly(capsys, "--fault", "state:planning.waypoint.x:bit=62@20.0")
    (injection,) = data["injections"]
    assert injection["level"] == "state" and injection["site"] == "planning.waypoint.x" and injection["bit"] == 62
    assert injection["activated"] and 20.0 <= injection["time_s"] < 21.0
    before, after = (struct.unpack("<Q", struct.pack("<d", float(injection[key])))[0] for key in ("before", "after"))
    assert before ^ after == 1 << 62
    assert data["golden"]["digest"] == golden_digest != data["digest"]
    assert data["effect"] == "sdc"


def test_a_detector_without_a_model_is_printed_without_a_profile(capsys, golden_digest):
    data = _fly(capsys, "--detector", "mavfi.detectors.detector:NoDetector")
    assert data["detector"] == "mavfi.detectors.detector:NoDetector"
    assert data["digest"] == golden_digest


@pytest.mark.slow
def test_saved_flight_and_picture(capsys, tmp_path, golden_digest):
    log, picture = tmp_path / "flight.npz", tmp_path / "flight.png"
    _fly(capsys, "--save", str(log), "--picture", str(picture))
    assert FlightLog.load(log).digest() == golden_digest
    assert picture.stat().st_size > 10_000


@pytest.mark.slow
def test_text_for_people_has_whole_names_at_any_width(capsys, monkeypatch):
    """A user's own detector under its own name, which is one long word."""
    monkeypatch.setenv("COLUMNS", "80")
    detector, site = "mavfi.detectors.detector:NoDetector", "perception.collision_status.time_to_collision"
    fault = ["--fault", f"state:{site}:bit=62@5"]
    assert run(["fly", "--environment", "sparse", "--seed", "7", "--detector", detector, *fault]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert all(len(line) <= 80 for line in lines)
    for name in (detector, site, "no alarm", "autopilot published", "effect", "bit 62 (exponent)", "golden", "digest"):
        assert any(name in line for line in lines), name


def test_a_mission_that_fails_is_no_failure_of_the_program(capsys):
    limited = ["--time-limit-factor", "1", "--goal", "30", "0", "3"]
    flown = _fly(capsys, *limited)
    assert flown["status"] == "timeout" and flown["time_limit_s"] == pytest.approx(flown["course_m"] / 3.0, abs=1e-5)
    assert run(["fly", "--environment", "sparse", "--seed", "7", *limited]) == 0
    assert "Did not reach the goal in time." in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--environment", "nowhere"], "allowed: clutter, dense"),
        (["--environment", "Absent.BT"], "Absent.BT: there is no such file"),
        (["--fault-seed", "5"], "--fault-seed: 5: no fault to draw"),
        (
            ["--dead-node", "readback"],
            "--dead-node: readback: no node can die; allowed: together with --fault instruction",
        ),
        (["--profile", "tuned"], "--profile: tuned: nothing watches"),
        (["--detector", "mavfi.detectors.detector:NoDetector", "--profile", "tuned"], "has no profiles"),
        (
            ["--detector", "recommended", "--trained-for", "published/i9-9940x"],
            "--trained-for: published/i9-9940x: detector 'recommended' is not trained",
        ),
        (["--start", "5", "0", "3", "--goal", "6.9", "0", "3"], "1.90 m from the start"),
        (["--save", "flight.csv"], "--save: flight.csv: allowed ending: .npz"),
        (["--map-resolution", "0.05"], "map resolution 0.05 m: 951,084,261 voxels"),
        (["--fault", "state:sensor.imu.fx"], "sensor.imu is published with localization estimator only, not truth"),
        (["--planner", "dijkstra"], "planner 'dijkstra'"),
        (["--detector", "gaussian", "--models", "absent"], "absent: there is no such folder of models"),
        (["--save", "absent/flight.npz"], "cannot be written"),
        (["--frobnicate"], "--frobnicate"),
        (["--seed", "1.5"], "--seed: '1.5': allowed: a whole number; see `mavfi fly --help`"),
        (["--pace", "3"], "--pace: 3: nothing shows the flight; allowed: together with --live or --mavlink"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(capsys, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert run(["fly", *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("mavfi: ") and captured.err.count("\n") == 1
    assert message in captured.err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("full.yaml", b"name: full\ngenerator: cuboids\nparameters: {density: 0.9, side: 10.0}\n", "density"),
        ("full.yaml", b"name: full\ngenerator: cuboids\nheight: 3\n", "full.yaml: unknown key 'height'"),
        ("cut.bt", b"# Octomap OcTree binary file\nid OcTree\nsize 100\nres 0.05\ndata\n\x01\x02", "cut.bt"),
    ],
)
def test_files_of_worlds_that_cannot_be_built_are_one_line(capsys, tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    assert run(["fly", "--environment", str(tmp_path / name), "--start", "0", "0", "1", "--goal", "5", "0", "1"]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


def test_a_start_inside_an_obstacle(capsys):
    from mavfi.flight.compose import resolve
    from mavfi.mission import MissionSpec
    from mavfi.sim.environments import build_world

    world = build_world(resolve(MissionSpec(environment="dense", seed=7)).environment, 7)
    x, y = 0.5 * (world.lower[0] + world.upper[0])[:2]
    assert run(["fly", "--environment", "dense", "--seed", "7", "--start", str(x), str(y), "2"]) == 2
    error = capsys.readouterr().err
    assert "start" in error and error.count("\n") == 1


def test_a_refused_place_keeps_what_is_there(capsys, tmp_path):
    held = tmp_path / "flight.npz"
    held.write_bytes(b"mine")
    assert run(["fly", "--environment", "nowhere", "--save", str(held)]) == 2
    assert held.read_bytes() == b"mine"


def test_a_fault_that_comes_after_the_flight_has_no_effect_and_is_not_called_masked(capsys):
    fault = "sensor:gyro:off@1000"
    assert run(["fly", "--environment", "sparse", "--seed", "7", "--fault", fault]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "not activated" in out and "none: nothing was injected" in out and "masked" not in out


def test_a_fault_at_an_alarm_needs_a_detector(capsys):
    words = "fly --fault state:control.command.vx:value=nan@1 --fault state:control.command.vx:bit=62@alarm"
    assert run(words.split()) == 2
    assert "nothing raises an alarm; allowed: together with --detector" in capsys.readouterr().err
