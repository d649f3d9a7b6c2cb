"""Detectors on recorded flights: false alarms, injected flips, known faults."""

import json
from dataclasses import replace

import pytest

from mavfi.cli.commands import run
from mavfi.errors import BadInputError
from mavfi.extras.logs.recording import read_recording
from mavfi.extras.logs.selection import Wanted, select
from mavfi.extras.logs.watch import Flip, JudgedLog, LogAlarm, LogRates, LogWatch
from mavfi.extras.shared.log_readers import open_flight_log
from tests.night import at_night


@pytest.fixture(scope="module")
def recordings(files):
    return {name: read_recording(files("csv", name)) for name in ("a", "b")}


@pytest.fixture(scope="module")
def watching(recordings):
    pair = [recordings["a"], recordings["b"]]
    return LogWatch("gaussian", "tuned", select(pair, pair, Wanted(["x", "y", "vz"])), pair)


def test_a_flight_of_the_training_has_no_alarm(watching, recordings):
    judged = watching.judge(recordings["a"])
    assert judged.alarms == [] and judged.messages == 600
    assert judged.exposure_s == pytest.approx(11.98)


def test_flips_are_drawn_by_class_and_detected(watching, recordings):
    judged = watching.judge(recordings["a"], flips=90, seed=5)
    classes = [flip.bit_class for flip in judged.flips]
    assert [classes.count(name) for name in ("sign", "exponent", "mantissa")] == [30, 30, 30]
    bits = {"sign": range(63, 64), "exponent": range(52, 63), "mantissa": range(52)}
    assert all(flip.bit in bits[flip.bit_class] and flip.field in ("x", "y", "vz") for flip in judged.flips)
    rates = {name: rate.rate for name, rate in LogRates([judged]).flips.items()}
    assert rates["sign"] > 0.5 and rates["exponent"] > 0.5 and rates["mantissa"] < 0.5
    assert watching.judge(recordings["a"], flips=90, seed=5).flips == judged.flips
    assert watching.judge(recordings["a"], flips=90, seed=6).flips != judged.flips


def test_a_known_fault_is_judged_by_its_delay(files):
    pytest.importorskip("pyulog")
    normal = [read_recording(files("ulg", name)) for name in ("a", "b")]
    faulty = read_recording(files("ulg", "fault"), "mavfi_fault:active")
    assert faulty.onset_us == 9_000_000
    judged_log = LogWatch("gaussian", "tuned", select(normal, [faulty]), normal).judge(faulty)
    assert judged_log.has_fault and 0 <= judged_log.fault_delay_s < 0.1
    assert judged_log.exposure_s == pytest.approx(8.98) and judged_log.after_fault_s == pytest.approx(2.98)


@pytest.mark.parametrize("ending", ["ulg", "tlog"])
def test_a_file_that_is_cut_is_named(files, tmp_path, ending):
    whole = files(ending, "a")
    data = whole.read_bytes()
    cut = tmp_path / f"short.{ending}"
    for missing in range(1, 6):
        cut.write_bytes(data[:-missing])
        assert open_flight_log(cut).is_cut()
    cut.write_bytes(data[: {"ulg": 2600, "tlog": 700}[ending]])
    recordings = [read_recording(whole), read_recording(cut)]
    assert not recordings[0].cut and recordings[1].cut
    with pytest.raises(BadInputError, match=rf"no numbers in common \(short.{ending}: cut, the last message"):
        select(recordings[1:], recordings)


def test_fields_of_which_no_flip_is_found_are_named():
    flips = [
        Flip("row", name, 63, "sign", detected) for name, detected in (("x", True), ("y", False)) for _ in range(5)
    ]
    rates = LogRates([JudgedLog("x", 60.0, 10, [], [*flips, Flip("row", "z", 63, "sign", False)])])
    assert rates.blind == ["row:y"]
    assert rates.to_json()["flips_by_field"]["row:x"]["sign"]["rate"] == 1.0


def test_alarms_close_together_are_one_event():
    alarms = [LogAlarm(0, time, "row", 2.0, ()) for time in (0, 900_000, 1_800_000, 5_000_000)]
    assert JudgedLog("x", 3600.0, 10, alarms, []).events == 2
    rates = LogRates([JudgedLog("x", 1800.0, 10, alarms, []), JudgedLog("y", 1800.0, 10, [], [])])
    assert rates.alarms.per_hour == pytest.approx(2.0)
    assert rates.headline().startswith("2 false alarm events in 60.0 min of normal flight: 2 [0.242, 7.22] per hour")


def test_gaps_are_no_exposure(recordings, watching):
    messages = recordings["a"].messages
    gap = replace(recordings["a"], messages=messages[:100] + messages[400:])
    assert watching.judge(gap).exposure_s == pytest.approx(99 * 0.02 + 199 * 0.02)


def test_topics_that_fall_silent_are_named(files):
    normal = [read_recording(files("mcap", name)) for name in ("a", "b")]
    log_watch = LogWatch("gaussian", "tuned", select(normal, normal), normal)
    assert all(log_watch.judge(recording).silences == [] for recording in normal)
    begin, pause = 4_000_000, range(6_000_000, 8_000_001)

    def is_recorded(message):
        if message.topic == "/command" and message.time_us > begin:
            return False
        return not (message.topic == "/tf[base_link]" and message.time_us in pause)

    lost = replace(normal[1], messages=[message for message in normal[1].messages if is_recorded(message)])
    judged = log_watch.judge(lost)
    assert [(silence.topic, silence.lasts) for silence in judged.silences] == [
        ("/command", True),
        ("/tf[base_link]", False),
    ]
    assert judged.silences[0].text() == "/command silent from 4.000 s to the end, 11.980 s"
    # a pause of the whole recording is no silence of a topic
    paused = [message for message in normal[1].messages if message.time_us not in pause]
    assert log_watch.judge(replace(normal[1], messages=paused)).silences == []
    # nor is a topic that comes rarely in the training
    rare = [message for message in normal[0].messages if message.topic != "/command" or message.time_us < begin]
    rare += [message for message in normal[0].messages if message.topic == "/command"][-1:]
    training = [replace(normal[0], messages=rare)]
    assert len(LogWatch("gaussian", "tuned", log_watch.selection, training).judge(lost).silences) == 1


@pytest.mark.parametrize("wanted", ["row:no_such", "vy:x"])
def test_fields_that_are_not_in_all_recordings_are_refused(recordings, wanted):
    pair = list(recordings.values())
    with pytest.raises(BadInputError, match=f"--fields: {wanted}: no such number in messages of .*; allowed: "):
        select(pair, pair, Wanted([wanted]))


@pytest.mark.parametrize("ending", ["mcap", "csv", *at_night("ulg", "tlog", "bag", "jsonl")])
def test_the_command_reads_every_format(files, ending, capsys):
    log, train = (str(files(ending, name)) for name in ("b", "a"))
    assert run(["watch", log, "--train", train, "--inject", "6", "--json"]) == 0
    judged_log = json.loads(capsys.readouterr().out)
    assert judged_log["alarms_per_hour"]["events"] <= 1 and judged_log["exposure_s"] == pytest.approx(11.98)
    assert {name: rate["n"] for name, rate in judged_log["flips"].items()} == {"sign": 2, "exponent": 2, "mantissa": 2}


def test_several_logs_that_are_split_are_all_counted(files, capsys):
    logs = [str(files("csv", name)) for name in ("a", "b")]
    assert run(["watch", *logs, "--split", "0.5", "--fields", "vx,vy", "--json"]) == 0
    judged_log = json.loads(capsys.readouterr().out)
    assert judged_log["trained_on"] == 600 and judged_log["fields"] == {"row": ["vx", "vy"]}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--train", "{}", "--split", "0.5"], "--train, --split: both given; allowed: one of them"),
        (["--train", "{}", "--detector", "oracle"], "--detector: oracle: compares values with those that were sent"),
        (["--train", "{}", "--fault", "mode"], "--fault: 'mode': allowed: TOPIC:FIELD"),
        (["--train", "none.xyz"], "no reader of flight logs knows this format"),
    ],
)
def test_bad_input_is_one_line(files, arguments, message, capsys):
    log, train = (str(files("csv", name)) for name in ("a", "b"))
    assert run(["watch", log, *(text.format(train) for text in arguments)]) == 2
    err = capsys.readouterr().err
    assert message in err and err.count("\n") == 1


def test_a_log_is_not_judged_by_a_detector_trained_on_it(files, tmp_path, capsys):
    log, other = files("csv", "a"), files("csv", "b")
    copy, link = tmp_path / "copy.csv", tmp_path / "link.csv"
    copy.write_bytes(log.read_bytes())
    link.symlink_to(log)
    for train in (log, copy, link):
        assert run(["watch", str(other), str(log), "--train", str(train)]) == 2
        printed = capsys.readouterr()
        assert printed.err.count("\n") == 1 and f"{log}: is also trained on" in printed.err and not printed.out
        assert (str(train) in printed.err.partition("trained on")[2]) == (train != log)
    (tmp_path / "bag").mkdir()
    description = tmp_path / "bag" / "metadata.yaml"
    description.write_text("rosbag2_bagfile_information: {}")
    assert run(["watch", str(description), "--train", str(tmp_path / "bag")]) == 2
    assert "is also trained on" in capsys.readouterr().err


def test_flips_that_no_field_can_have_are_said_to_be_none(files, capsys):
    log, train = (str(files("tlog", name)) for name in ("b", "a"))
    words = ["watch", log, "--train", train, "--fields", "GLOBAL_POSITION_INT:vx", "--inject", "6"]
    assert run(words) == 0
    assert "no bit flipped: only floating-point numbers are" in capsys.readouterr().out
