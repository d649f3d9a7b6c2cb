"""`mavfi fly --html` and `mavfi explain --html`: pages of one flight."""

import json
import re

import pytest

from mavfi.cli import run

FAULT = ("--fault", "state:planning.waypoint.x:bit=62@20.0")


def written(capsys, path, *arguments):
    assert run([*map(str, arguments), "--html", str(path)]) == 0
    assert f"wrote {path}" in capsys.readouterr().out
    text = path.read_text(encoding="utf-8")
    assert len(text.encode()) < 3_000_000
    return json.loads(re.search(r'id="flight-data">(.*?)</script>', text, re.DOTALL)[1])


def roles(page):
    return [path["role"] for path in page["data"]["paths"]]


def test_a_flight_without_a_fault_has_one_path_and_no_time_line(capsys, tmp_path):
    page = written(capsys, tmp_path / "a.html", "fly", "--environment", "sparse", "--seed", "7")
    assert (roles(page), page["data"]["lines"], page["data"]["fault"]) == (["golden"], [], None)
    assert page["commands"] == [["fly it again", "mavfi fly --environment sparse --seed 7"]]


@pytest.mark.slow
@pytest.mark.long
def test_a_watched_fault_is_shown_with_and_without_its_detector(capsys, tmp_path):
    arguments = ("--environment", "sparse", "--seed", "7", *FAULT, "--detector", "gaussian")
    page = written(capsys, tmp_path / "a.html", "fly", *arguments)
    assert roles(page) == ["golden", "injected", "recovered"]
    assert page["verdict"].startswith("with detector gaussian (paper), ")
    assert page["data"]["lines"][0]["label"] == "planning.waypoint.x"
    assert set(page["data"]["lines"][0]["data"]) == {"golden", "injected", "recovered"}
    assert page["commands"][0][1] == f"mavfi fly {' '.join(arguments)}"


def test_a_fault_in_an_instruction_has_time_lines_of_what_it_made_wrong(capsys, tmp_path):
    short = ("--environment", "sparse", "--seed", "7", "--start", "2", "0", "3", "--goal", "9", "0", "3")
    fault = ("--fault", "instruction:pid:which=floating_point", "--fault-seed", "1")
    page = written(capsys, tmp_path / "a.html", "fly", *short, *fault)
    labels = [line["label"] for line in page["data"]["lines"]]
    assert labels and labels[0].startswith("control.command.")
    assert not any(line["site"] for line in page["data"]["lines"]), "the fault is in an instruction, not in a field"
    lines = page["data"]["lines"][0]["data"]
    assert lines["golden"][1] != lines["injected"][1]


def test_another_ending_is_refused_before_anything_is_flown(capsys, tmp_path):
    assert run(["fly", "--html", str(tmp_path / "a.pdf")]) == 2
    assert "allowed ending: .html" in capsys.readouterr().err
