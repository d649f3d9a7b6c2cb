import pytest

from mavfi.campaign.steps import FILE, Steps, machine, program
from mavfi.errors import BadInputError


def test_times_of_a_resumed_study_add_up(tmp_path, monkeypatch):
    clock = iter([0.0, 2.0, 10.0, 15.0, 20.0, 21.0])
    monkeypatch.setattr("time.perf_counter", lambda: next(clock))
    first = Steps.begin(tmp_path, 2)
    with first.timed("compilation"):
        pass
    with pytest.raises(KeyboardInterrupt), first.timed("campaign table1"):
        raise KeyboardInterrupt
    second = Steps.begin(tmp_path, 1)
    assert second.seconds == {"compilation": 2.0, "campaign table1": 5.0}, "what was interrupted counts, too"
    with second.timed("compilation"):
        pass
    held = Steps.load(tmp_path)
    assert held.seconds == {"compilation": 3.0, "campaign table1": 5.0}
    assert [run["machine"] for run in held.runs] == [f"{machine()}, 2 workers", f"{machine()}, 1 worker"]
    assert {run["program"] for run in held.runs} == {program()} and program().startswith("mavfi ")


def test_a_file_of_a_version_without_the_program_is_read(tmp_path):
    (tmp_path / FILE).write_text('{"seconds": {}, "runs": [{"begun": "then", "machine": "one"}]}', encoding="utf-8")
    assert Steps.load(tmp_path).runs == [{"begun": "then", "machine": "one", "program": ""}]


def test_flights_of_a_version_without_the_file_are_said_to_have_no_record(tmp_path):
    (tmp_path / "table1").mkdir()
    (tmp_path / "table1" / "campaign.sqlite").touch()
    assert [run["begun"][:6] for run in Steps.begin(tmp_path, 2).runs][0] == "before"
    assert len(Steps.begin(tmp_path / "elsewhere", 2).runs) == 1


def test_without_a_file_there_are_none_and_a_damaged_one_is_named(tmp_path):
    assert Steps.load(tmp_path) == Steps(tmp_path)
    for text in ("{", "[]", '{"seconds": {"a": "x"}, "runs": []}', '{"seconds": {}, "runs": [{}]}'):
        (tmp_path / FILE).write_text(text, encoding="utf-8")
        with pytest.raises(BadInputError, match="steps.json: is not a file of wall times"):
            Steps.load(tmp_path)
