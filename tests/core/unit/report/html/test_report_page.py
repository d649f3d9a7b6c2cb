"""What the report page is made of: links to runs, size, escaping; what it does is tested in test_browser.py."""

import json
import re
from importlib.resources import files

import pytest

from mavfi.analysis.table import Table
from mavfi.errors import BadInputError
from mavfi.report import style
from mavfi.report.campaign_report import report_of
from mavfi.report.html import page, report_page
from mavfi.report.html.report_page import (
    PageSection,
    ReportedCampaign,
    RunSets,
    drawn,
    run_list,
    sections_of,
    svg_of,
    write_page,
    write_report_page,
)

COMMANDS = [("Fly it", "mavfi campaign run tiny --out out/tiny")]


@pytest.fixture(scope="module")
def report(runs):
    return report_of(runs)


def written(tmp_path, report, flown, sections=None, flights=(), **more):
    path = tmp_path / "report.html"
    chosen = sections_of(report) if sections is None else sections
    count = write_report_page(path, [ReportedCampaign(flown, report)], chosen, COMMANDS, flights, **more)
    return count, path.read_text(encoding="utf-8")


def test_the_same_runs_are_stored_once():
    sets = RunSets({"a": 0, "b": 1, "c": 2, "e": 4})
    assert sets.link(["c", "a", "b"]) == sets.link(["a", "b", "c"]) == "#runs?set=0"
    assert sets.link(["e", "a"]) == "#runs?set=1" and sets.link(["unknown"]) == ""
    assert list(sets.texts) == ["0-2", "0 4"]


def test_text_from_data_is_never_markup(tmp_path, report, flown):
    table = Table.of_text("<b>bold</b>", ["<i>"], [("</script><script>alert(1)",)], ["a & b"])
    _, text = written(tmp_path, report, flown, [PageSection("<u>", [table])])
    assert "<b>bold" not in text and "alert(1)" in text and "<script>alert" not in text
    data = re.search(r'id="csv-data">(.*?)</script>', text, re.DOTALL)[1]
    assert "</script><script>alert(1)" in json.loads(data)["0-<b>bold</b>"]


@pytest.mark.slow
def test_flights_are_taken_while_they_fit(tmp_path, report, flown, flight):
    def endless():
        for number in range(1000):
            taken.append(number)
            yield f"run-{number}", flight

    taken = []
    none, text = written(tmp_path, report, flown)
    size, room = len(text.encode()), 5 * len(page.as_json(flight.to_json()))
    count, text = written(tmp_path, report, flown, flights=endless(), largest=size + room)
    assert 3 <= count <= 5 and none == 0 and len(text.encode()) <= size + room
    assert len(taken) == count + 1
    with pytest.raises(BadInputError, match="without any flight; allowed: 1000"):
        written(tmp_path, report, flown, largest=1000)


@pytest.mark.parametrize("at_once", [False, True])
def test_what_is_done_is_in_the_page_when_the_time_is_up_or_at_ctrl_c(
    tmp_path, report, flown, flight, monkeypatch, at_once
):
    path = tmp_path / "report.html"

    def show(done, total):
        assert path.is_file() and 'class="flight-data"' not in path.read_text(encoding="utf-8"), "written before"
        if at_once and done == 3:
            raise KeyboardInterrupt

    monkeypatch.setattr(report_page, "_page", lambda case: flight)
    if not at_once:
        monkeypatch.setattr(report_page, "DEFAULT_SECONDS", 0.0)
    campaigns = [ReportedCampaign(flown, report)]
    written_page = write_page(path, campaigns, sections_of(report)[:1], COMMANDS, None, 1, show)
    assert (written_page.stored, written_page.is_stopped) == (
        (3, True) if at_once else (1, False)
    ) and written_page.chosen > 3
    assert path.read_text(encoding="utf-8").count('class="flight-data"') == written_page.stored


def test_the_libraries_are_there_with_their_licences(flight_html):
    text = flight_html.read_text(encoding="utf-8")
    assert "three.js authors" in text and "Leon Sorokin" in text and text.count("Permission is hereby granted") == 2
    assert len(text.encode()) < 3_000_000
    assert not re.search(r'(src|href)="(https?:)?//', text)


def test_figures_follow_the_theme_and_their_ids_are_unique(runs):
    figures = drawn(runs)
    text = "".join(
        svg_of(figure.figure, f"f{number}", figure.caption, RunSets({})) for number, figure in enumerate(figures)
    )
    assert "var(--ink)" in text and "#222222" not in text
    ids = re.findall(r'\bid="([^"]*)"', text)
    assert ids and len(ids) == len(set(ids))
    n = len(runs.where("judged", setting="fi", population="sign_exponent"))
    assert f'aria-label="{n} runs: environment sparse, setting fi' in text


def test_a_role_has_one_colour_in_pages_and_pictures():
    light_theme = (files("mavfi.report.html") / "base.css").read_text(encoding="utf-8").partition("}")[0]
    for name, colour in (
        ("golden", style.GOLDEN),
        ("injected", style.FAULT),
        ("recovered", style.RECOVERED),
        ("amber", style.INJECTION),
        ("purple", style.ALARM),
    ):
        assert f"--{name}: {colour.lower()};" in light_theme


def test_the_list_of_runs_has_every_run(runs):
    data = run_list({"out/tiny": runs})
    assert data["ids"] == runs["run_id"]
    effects = data["texts"]["effect"]
    assert [effects["values"][code] for code in effects["codes"]] == runs["effect"]
    assert data["texts"]["folder"]["values"] == ["out/tiny"]
