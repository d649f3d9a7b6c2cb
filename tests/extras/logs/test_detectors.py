"""Any detector on any recording: fitted ones, rules on what is mapped, and custom ones."""

import json

import numpy as np
import pytest

from mavfi import Detector
from mavfi.cli.commands import run
from mavfi.config import names, shipped
from mavfi.detectors.detector import Alarm
from mavfi.errors import BadInputError
from mavfi.extras.logs.mapping import FOLDER, LogMapping, choose_mapping
from mavfi.extras.logs.recording import LogRecording, read_recording
from mavfi.extras.logs.selection import Wanted, select
from mavfi.extras.logs.watch import LogWatch
from mavfi.extras.shared.log_readers import LoggedMessage, RecordLayout


class SlowOnly(Detector):
    """Reads commands of missions."""

    states = frozenset({"control.command"})

    def check(self, state, time_us):
        if not abs(state.value("vx")) < 20.0:
            return Alarm("slow", "control", score=2.0, fields=("control.command.vx",))
        return None


class SmallOnly(Detector):
    """Reads messages themselves."""

    def check(self, state, time_us):
        for field in state.spec.header:
            if not abs(state.value(field.name)) < 100.0:
                return Alarm("small", "control", score=2.0, fields=(f"{state.spec.name}.{field.name}",))
        return None


class Broken(Detector):
    """Asks messages for a field that they do not have."""

    def check(self, state, time_us):
        return state.value("nothing")


class NeedsLimits(Detector):
    """Takes limits of the mission, which are measured in the training."""

    def __init__(self, limits):
        self.v_max = limits.v_max

    def check(self, state, time_us):
        if state.spec.name == "sensor.odometry" and abs(state.value("vx")) > 1.5 * self.v_max:
            return Alarm("limits", "perception", score=2.0, fields=("sensor.odometry.vx",))
        return None


def recording(name, columns, topic, period_us=20_000):
    """Messages of one topic with these columns."""
    size = len(next(iter(columns.values())))
    rows = np.zeros(size, [(column, "<f4") for column in columns])
    for column, values in columns.items():
        rows[column] = values
    layout = RecordLayout.of(topic, rows.dtype)
    messages = [LoggedMessage(topic, period_us * index, layout, row.tobytes()) for index, row in enumerate(rows)]
    return LogRecording(name, messages)


def circle(phase):
    """A flight on a circle, in PX4's frame."""
    time = 0.02 * np.arange(400)
    x, y = 5.0 * np.cos(0.5 * time + phase), 5.0 * np.sin(0.5 * time + phase)
    velocity = {"vx": -0.5 * y, "vy": 0.5 * x, "vz": np.zeros(400)}
    resets = np.where(time > 4.0, 1.0, 0.0)
    return {"x": x, "y": y, "z": -3.0 + 0.0 * x, **velocity, "xy_reset_counter": resets}


@pytest.mark.parametrize(
    ("field", "value", "named", "rule"),
    [
        ("x", 30.0, "x", "rule 3, step along the velocity"),
        ("vy", -40.0, "vy", "rule 3, velocity change"),
        ("vx", 8.0, "vx", "rule 3, velocity change"),
        ("xy_reset_counter", 5.0, "xy_reset_counter", "rule 1, counter 0 -> 5"),
    ],
)
def test_rules_name_the_field_and_the_rule(field, value, named, rule):
    topic = "vehicle_local_position"
    normal = [recording(f"{phase}.ulg", circle(phase), topic) for phase in (0.0, 1.0)]
    columns = circle(2.0)
    columns[field][100] = value
    wrong = recording("wrong.ulg", columns, topic)
    selection = select(normal, [wrong], Wanted(mapping="", only_mapped=True))
    assert selection.mapping.name == "px4" and list(selection.mapping.states) == ["sensor.odometry"]
    log_watch = LogWatch("recommended", "tuned", selection, normal)
    assert log_watch.judge(recording("fine.ulg", circle(2.0), topic)).alarms == []
    first = log_watch.judge(wrong).alarms[0]
    assert (first.time_us, first.topic, first.fields) == (2_000_000, topic, (named,))
    assert first.source.startswith(rule)


def test_rules_judge_the_steps_of_slow_logs():
    topic = "vehicle_local_position"
    normal = [recording("a.ulg", circle(0.0), topic, 5_000_000)]
    columns = circle(1.0)
    columns["x"][100] = 300.0
    wrong = recording("b.ulg", columns, topic, 5_000_000)
    selection = select(normal, [wrong], Wanted(mapping="px4", only_mapped=True))
    alarms = LogWatch("recommended", "tuned", selection, normal).judge(wrong).alarms
    assert [alarm.time_us for alarm in alarms] == [500_000_000, 505_000_000]


def test_another_entry_of_the_mapping_stands_in_for_numbers_that_are_not_finite():
    topic = "trajectory_setpoint"
    velocity = dict(zip(("velocity[0]", "velocity[1]", "velocity[2]", "yawspeed"), np.zeros((4, 400)), strict=True))
    velocity["velocity[0]"][100:110] = np.nan
    parts = [recording("a.ulg", velocity, topic), recording("a.ulg", circle(0.0), "vehicle_local_position_setpoint")]
    normal = LogRecording("a.ulg", [message for part in parts for message in part.messages])
    mapping = select([normal], [normal], Wanted(mapping="px4", only_mapped=True)).mapping
    assert mapping.states["control.command"].topic == "vehicle_local_position_setpoint"


@pytest.mark.parametrize("kind", ["SlowOnly", "SmallOnly", "NeedsLimits"])
def test_custom_detectors_see_messages_and_states(kind):
    topic = "vehicle_local_position_setpoint"
    if kind == "NeedsLimits":
        topic = "vehicle_local_position"
    normal = [recording("a.ulg", circle(0.0), topic)]
    columns = circle(1.0)
    columns["vx"][50] = 1000.0
    wrong = recording("b.ulg", columns, topic)
    selection = select(normal, [wrong], Wanted(mapping=""))
    judged = LogWatch(f"{__name__}:{kind}", "tuned", selection, normal).judge(wrong)
    assert [(alarm.time_us, alarm.topic, alarm.fields) for alarm in judged.alarms] == [(1_000_000, topic, ("vx",))]


def test_the_exception_of_a_custom_detector_is_one_line(files, capsys):
    logs = [str(files("csv", name)) for name in ("b", "a")]
    assert run(["watch", logs[0], "--train", logs[1], "--detector", f"{__name__}:Broken"]) == 2
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1 and ":Broken: check of row: ValueError: no field of name nothing" in printed


def test_detectors_of_all_fields_learn_from_recordings(files):
    normal = [read_recording(files("csv", "a"))]
    judged = [read_recording(files("csv", "b"))]
    log_watch = LogWatch("limits", "tuned", select(normal, judged, Wanted(["x", "y", "vx", "vy"])), normal)
    result = log_watch.judge(judged[0], flips=60)
    assert result.events <= 1
    detected = [flip.detected for flip in result.flips if flip.bit_class == "sign"]
    assert np.mean(detected) >= 0.8
    assert log_watch.judge(judged[0], flips=60).flips == result.flips


def test_a_mapping_of_ones_own(files, tmp_path, capsys):
    path = tmp_path / "mine.yaml"
    path.write_text(
        "name: mine\nstates:\n  - state: sensor.odometry\n    topic: row\n"
        "    fields: {x: x, y: y, z: z, vx: vx, vy: vy, vz: vz}\n"
    )
    logs = [str(files("csv", name)) for name in ("b", "a")]
    picture = tmp_path / "p.png"
    options = ["--detector", "recommended", "--mapping", str(path), "--picture", str(picture), "--json"]
    assert run(["watch", logs[0], "--train", logs[1], "--inject", "60", *options]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["mapping"]["name"] == "mine" and result["alarms_per_hour"]["events"] == 0
    assert result["flips"]["sign"]["rate"] >= 0.5 and result["fields"] == {"row": ["x", "y", "z", "vx", "vy", "vz"]}
    assert picture.stat().st_size > 1000
    assert run(["watch", logs[0], "--train", logs[1], "--detector", "recommended"]) == 2
    refusal = capsys.readouterr().err
    assert "mavlink needs LOCAL_POSITION_NED;" in refusal and "allowed: --mapping FILE" in refusal


def test_the_line_about_rules_names_the_nearest_mapping_and_what_it_lacks():
    columns = circle(0.0)
    del columns["vz"]
    normal = [recording("a.ulg", columns, "vehicle_local_position")]
    with pytest.raises(BadInputError, match="nearest: px4, which lacks vehicle_local_position:vz, .* and .* more"):
        select(normal, normal, Wanted(mapping="", only_mapped=True))
    columns = circle(0.0)
    columns["vz"][200:] = np.nan
    normal = [recording("a.ulg", columns, "vehicle_local_position")]
    reason = r"no vehicle_local_position:vz.*; vehicle_local_position:vz not finite in a.ulg, first at 4.00 s"
    with pytest.raises(BadInputError, match=reason):
        select(normal, normal, Wanted(mapping="px4", only_mapped=True))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("sensor.odometry", "sensor.nothing", "no such state"),
        ("vx: vx", "speed: vx", "field 'speed': not known"),
        ("vx: vx", "vx: vx furlong", "allowed: .*cm/s"),
        ("vx: vx", "vx: none", "nothing can be mapped .sensor.odometry: no row:none"),
    ],
)
def test_mappings_that_are_refused(tmp_path, old, new, message):
    path = tmp_path / "mine.yaml"
    text = "name: mine\nstates:\n  - {state: sensor.odometry, topic: row, fields: {vx: vx}}\n"
    path.write_text(text.replace(old, new))
    with pytest.raises(BadInputError, match=message):
        choose_mapping(str(path), {"row": ["vx"]})


def test_every_shipped_mapping_is_valid_and_is_chosen_for_its_own_topics():
    for name in names(FOLDER):
        available: dict[str, set[str]] = {}
        for part in shipped(FOLDER, LogMapping, name).states:
            for source in part.sources().values():
                available.setdefault(source.topic, set()).add(source.path)
        assert choose_mapping("", available).name == name


def test_a_column_can_tell_of_the_fault(tmp_path, capsys):
    time = 0.02 * np.arange(600)
    x = np.sin(time)
    lines = [f"{t},{v},{int(n == 500)}" for n, (t, v) in enumerate(zip(time, x, strict=True))]
    normal, faulty = tmp_path / "normal.csv", tmp_path / "faulty.csv"
    normal.write_text("\n".join(["t,x,label", *lines[:400]]))
    lines[500] = f"{time[500]},40.0,1"
    faulty.write_text("\n".join(["t,x,label", *lines]))
    assert run(["watch", str(faulty), "--train", str(normal), "--fault", "row:label", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["delays_s"] == [0.0] and result["fields"] == {"row": ["x"]}
    assert result["recordings"][0]["fault_alarm"]["fields"] == ["x"]
