import pytest

from mavfi.errors import BadInputError
from mavfi.extras.paper import steps
from mavfi.extras.paper.steps import FILE, SET_UP_FILE, StepTimes, machine, program


@pytest.fixture(autouse=True)
def set_up_file(monkeypatch, tmp_path_factory):
    """Where `make setup` writes how long it took; absent at first."""
    path = tmp_path_factory.mktemp("environment") / SET_UP_FILE.name
    monkeypatch.setattr(steps, "SET_UP_FILE", path)
    return path


def test_times_of_a_resumed_study_add_up(tmp_path, monkeypatch):
    clock = iter([0.0, 2.0, 10.0, 15.0, 20.0, 21.0])
    monkeypatch.setattr("time.perf_counter", lambda: next(clock))
    first = StepTimes.begin(tmp_path, 2)
    with first.timed("compilation"):
        pass
    with pytest.raises(KeyboardInterrupt), first.timed("campaign table1"):
        raise KeyboardInterrupt
    second = StepTimes.begin(tmp_path, 1)
    assert second.seconds == {"compilation": 2.0, "campaign table1": 5.0}, "what was interrupted counts, too"
    with second.timed("compilation"):
        pass
    held = StepTimes.load(tmp_path)
    assert held.seconds == {"compilation": 3.0, "campaign table1": 5.0}
    assert [run["machine"] for run in held.runs] == [f"{machine()}, 2 workers", f"{machine()}, 1 worker"]
    assert {run["program"] for run in held.runs} == {program()} and program().startswith("mavfi ")


def test_without_a_file_there_are_none_and_a_damaged_one_is_named(tmp_path):
    assert StepTimes.load(tmp_path) == StepTimes(tmp_path)
    for text in ("{", "[]", '{"seconds": {"a": "x"}, "runs": []}', '{"seconds": {}, "runs": [{}]}'):
        (tmp_path / FILE).write_text(text, encoding="utf-8")
        with pytest.raises(BadInputError, match="steps.json: is not a file of wall times"):
            StepTimes.load(tmp_path)
