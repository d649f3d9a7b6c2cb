"""What `watch` makes of angles, of numbers that are not finite, and of the rate of a log."""

import json

import numpy as np
import pytest

from mavfi.cli.commands import run
from mavfi.extras.logs.recording import exposure_s, longest_gap_us
from mavfi.extras.logs.selection import CONSTANT, COUNTS

TIME = np.arange(0.0, 30.0, 0.02)
NUMBER = np.arange(len(TIME), dtype=float)


@pytest.fixture
def table(tmp_path):
    """Function (name, columns) -> path of a table."""

    def write(name, columns):
        path = tmp_path / name
        rows = np.column_stack(list(columns.values()))
        lines = [",".join(columns), *(",".join(repr(float(value)) for value in row) for row in rows)]
        path.write_text("\n".join(lines) + "\n")
        return str(path)

    return write


def judged(capsys, *arguments):
    assert run(["watch", *arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_a_field_that_never_changes_or_is_never_valid_is_named_and_not_monitored(table, capsys):
    signal = np.sin(TIME) + 0.01 * np.cos(7 * NUMBER)
    columns = {"time": TIME, "x": signal, "idle": 0 * TIME + 900.0, "lost": TIME * np.nan}
    logs = [table("a.csv", columns), table("b.csv", columns | {"idle": 900.0 + (TIME > 20.0)})]
    result = judged(capsys, logs[1], "--train", logs[0])
    assert result["fields"] == {"row": ["x"]} and result["alarms_per_hour"]["events"] == 0
    reasons = {item["field"]: item["reason"] for item in result["not_monitored"]}
    assert reasons == {"idle": CONSTANT, "lost": "never finite in a.csv"}
    result = judged(capsys, logs[1], "--train", logs[0], "--fields", "x,idle")
    assert result["fields"] == {"row": ["x", "idle"]} and result["alarms_per_hour"]["events"] > 0


@pytest.mark.parametrize("bits", [16, 32])
def test_a_wrapped_unsigned_number_is_named_and_not_trained_on(table, capsys, bits):
    """Trained on it, the largest normal value would be that of the whole range."""
    stick = 1500.0 + NUMBER % 40
    wrapped = np.where(NUMBER == 300, 2.0**bits - 3, stick)
    beyond = np.where(NUMBER == 900, 30_000.0, stick)
    logs = [table("a.csv", {"time": TIME, "stick": wrapped}), table("b.csv", {"time": TIME, "stick": beyond})]
    assert run(["watch", logs[1], "--train", logs[0], "--json"]) == 0
    captured = capsys.readouterr()
    line = "a.csv: not trained on 1 of 1500 messages of row: stick is at the end of an unsigned range, first "
    assert f"{line}{2**bits - 3} at" in captured.err
    assert json.loads(captured.out)["alarms_per_hour"]["events"] > 0


def turn(centre, phase, period, low):
    """An angle (rad, or in the unit of `period`) that swings about a centre (rad)."""
    noise = 0.002 * np.random.default_rng(int(10 * phase)).standard_normal(len(TIME))
    angle = centre + 0.8 * np.sin(0.5 * TIME + phase) + noise
    return np.mod(angle * period / (2 * np.pi) - low, period) + low


def test_an_angle_that_passes_the_end_of_its_range_only_later_is_declared(table, capsys):
    logs = [
        table(f"{phase}.csv", {"time": TIME, "yaw": turn(centre, phase, 360.0, -180.0)})
        for centre, phase in ((2.0, 0.0), (np.pi, 1.1))
    ]
    assert judged(capsys, logs[1], "--train", logs[0])["alarms_per_hour"]["events"] > 0
    result = judged(capsys, logs[1], "--train", logs[0], "--kinds", "yaw=deg")
    assert result["alarms_per_hour"]["events"] == 0
    assert result["angles_and_quaternions"] == {"row:yaw": "angle (deg)"}


def test_what_a_field_is_can_be_declared(table, capsys):
    ramp = np.mod(TIME, 10.0)
    logs = [table(f"{shift}.csv", {"time": TIME, "yaw": np.mod(ramp + shift, 10.0)}) for shift in (0, 3)]
    result = judged(capsys, logs[1], "--train", logs[0], "--kinds", "yaw=number")
    assert result["angles_and_quaternions"] == {}
    assert run(["watch", logs[1], "--train", logs[0], "--kinds", "yaw=turns"]) == 2
    assert "allowed: FIELD=KIND with a KIND of rad, deg" in capsys.readouterr().err
    assert run(["watch", logs[1], "--train", logs[0], "--kinds", "roll=deg"]) == 2
    assert "--kinds: roll: no monitored field; allowed: row:yaw" in capsys.readouterr().err


def test_a_number_that_is_not_finite_any_more_is_an_alarm(table, capsys):
    rates = [np.sin(TIME), np.cos(TIME)]
    never = np.where(TIME > 29.0, np.nan, 0.0)
    normal = table("normal.csv", {"time": TIME, "p": rates[0], "q": rates[1], "r": never})
    for value in (np.nan, np.inf):
        lost = np.where(TIME >= 20.0, value, rates[1])
        crash = table("crash.csv", {"time": TIME, "p": rates[0], "q": lost, "r": never})
        result = judged(capsys, crash, "--train", normal)
        (recording,) = result["recordings"]
        first = recording["alarms"][0]
        assert (first["time_us"], first["fields"], first["source"]) == (20_000_000, ["q"], "not finite")
        assert recording["events"] == 1
    assert result["not_monitored"] == [
        {"topic": "row", "field": "r", "reason": "not finite in normal.csv, first at 29.02 s"}
    ]
    assert run(["watch", crash, "--train", normal]) == 0
    printed = capsys.readouterr().out
    assert "not monitored, not finite in normal.csv: row:r" in printed


def test_a_second_cause_within_a_lasting_alarm_is_named(table, capsys):
    normal = table("normal.csv", {"time": TIME, "p": np.sin(TIME), "q": np.cos(TIME)})
    q = np.cos(TIME)
    q[1200] += 30.0
    crash = table("crash.csv", {"time": TIME, "p": np.where(TIME >= 20.0, np.nan, np.sin(TIME)), "q": q})
    assert run(["watch", crash, "--train", normal]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("crash.csv ")]
    assert len(lines) == 1
    assert lines[0].startswith("crash.csv 20.000 to 29.980 s: row p: not finite, 498 messages; row q: gaussian, score ")
    assert lines[0].endswith(", 2 messages from 24.000 s")
    # events that come again with the same fields leave room for others
    p = np.sin(TIME)
    p[200:1400:100] = np.nan
    crash = table("crash.csv", {"time": TIME, "p": p, "q": np.where(NUMBER == 1450, 30.0, np.cos(TIME))})
    assert run(["watch", crash, "--train", normal]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("crash.csv ")]
    assert len(lines) == 2 and "row q: gaussian" in lines[1]
    assert lines[0].endswith("row p: not finite; 12 events of these fields, the last at 26.000 s")


@pytest.mark.parametrize(
    ("gaps", "expected"),
    [
        ([0.02] * 100, 2.0),
        ([0.02] * 50 + [60.0] + [0.02] * 50, 2.0),  # a pause
        ([1.0, 1.1, 0.95] * 20, 61.0),  # 1 Hz
        (([0.01] * 100 + [9.0]) * 10, 100.0),  # bursts
        (([0.02] * 100 + [4.0] + [0.02] * 50 + [30.0]) * 3, 9.0),  # pauses of all kinds
        ([0.02] * 50 + [-3.0] + [0.02] * 50, 2.0),  # a clock that was set back
    ],
)
def test_exposure_follows_from_the_rate_of_the_log(gaps, expected):
    times_us = np.rint(1e6 * np.cumsum([0.0, *gaps])).astype(np.int64)
    assert exposure_s(times_us, longest_gap_us(times_us)) == pytest.approx(expected)


def test_the_first_message_of_a_recording_has_no_change_to_judge(table, capsys):
    near = {"time": TIME, "x": np.sin(TIME), "y": np.cos(TIME)}
    logs = [table("a.csv", near), table("b.csv", {**near, "x": near["x"] + 7e6})]
    result = judged(capsys, logs[1], "--train", logs[0])
    assert result["alarms_per_hour"]["events"] == 0 and result["fields"] == {"row": ["x", "y"]}


def test_counters_are_not_monitored_unless_they_are_named(table, capsys):
    logs = [table(f"{n}.csv", {"time": TIME, "seq": n + NUMBER, "x": np.sin(TIME + n)}) for n in (0, 9000)]
    result = judged(capsys, logs[1], "--train", logs[0])
    assert result["fields"] == {"row": ["x"]}
    assert result["not_monitored"] == [{"topic": "row", "field": "seq", "reason": COUNTS}]
    for option in (["--fields", "seq,x"], ["--kinds", "seq=number"]):
        assert judged(capsys, logs[1], "--train", logs[0], *option)["fields"] == {"row": ["seq", "x"]}


def test_a_number_that_is_not_finite_at_first_is_monitored_from_then_on(table, capsys):
    logs = []
    for name, begin, phase in (("a", 2.0, 0.0), ("b", 3.0, 1.0)):
        roll = 1e3 + np.sin(TIME + phase)
        roll[TIME < begin] = np.nan
        if name == "b":
            roll[1000] += 40.0
        columns = {"time": TIME, "roll": roll, "vx": np.cos(TIME + phase), "dead": np.nan * TIME}
        logs.append(table(f"{name}.csv", columns))
    result = judged(capsys, logs[1], "--train", logs[0], "--inject", "90")
    assert result["fields"] == {"row": ["roll", "vx"]} and result["flips_by_field"]["row:roll"]["sign"]["rate"] == 1.0
    alarms = result["recordings"][0]["alarms"]
    assert [alarm["time_us"] for alarm in alarms] == [20_000_000, 20_020_000]
    assert [item["field"] for item in result["not_monitored"]] == ["dead"]
