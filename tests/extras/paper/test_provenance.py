import pytest

from mavfi.errors import BadInputError
from mavfi.extras.paper.provenance import FILE, load_runs, machine, note_run, program


def test_a_resumed_study_adds_its_run(tmp_path):
    note_run(tmp_path, 2)
    note_run(tmp_path, 1)
    runs = load_runs(tmp_path)
    assert [run["machine"] for run in runs] == [f"{machine()}, 2 workers", f"{machine()}, 1 worker"]
    assert {run["program"] for run in runs} == {program()} and program().startswith("mavfi ")


def test_without_a_file_there_are_none_and_a_damaged_one_is_named(tmp_path):
    assert load_runs(tmp_path) == []
    for text in ("{", "[1]", '[{"begun": "now"}]'):
        (tmp_path / FILE).write_text(text, encoding="utf-8")
        with pytest.raises(BadInputError, match="runs.json: does not list runs of a study"):
            load_runs(tmp_path)
