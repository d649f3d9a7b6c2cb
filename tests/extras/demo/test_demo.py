"""`mavfi demo`: what is told of a fault is what happened in its flights, in the terminal and on the pages."""

import pytest

from mavfi.errors import BadInputError
from mavfi.extras.demo import cli
from mavfi.extras.demo.faults import DEMOS, FlownDemo, demo, headline
from mavfi.extras.demo.page import write_demo_page
from tests.core.unit.report.html.conftest import browser, driver  # noqa: F401
from tools.build_demo import PAGE, PICTURES, entry

NUMBER = 1


@pytest.fixture(scope="module")
def flown():
    return FlownDemo(NUMBER, demo(NUMBER), demo(NUMBER).fly())


def test_the_page_of_the_documentation_has_all_faults_with_small_pictures():
    page = PAGE.read_text(encoding="utf-8")
    positions = [page.index(f"## {number}. {chosen.title}\n") for number, chosen in enumerate(DEMOS, start=1)]
    assert positions == sorted(positions) and len(DEMOS) == 10
    assert all(f"    {chosen.command}\n" in page for chosen in DEMOS)
    pictures = [PICTURES / f"{number}.png" for number in range(1, len(DEMOS) + 1)]
    assert sorted(PICTURES.iterdir()) == sorted(pictures)
    assert sum(picture.stat().st_size for picture in pictures) < 600_000


def test_the_page_says_what_happens(flown):
    assert entry(flown) in PAGE.read_text(encoding="utf-8"), "run `make docs`"
    assert flown.is_lost and flown.is_recovered
    assert headline([flown]).startswith("1 of 1 faults lose a mission of 38.6 s (dense, seed 10007); the detector ")


@pytest.mark.long
@pytest.mark.parametrize("number", range(2, len(DEMOS) + 1))
def test_the_page_says_what_happens_with_every_fault(number):
    flown = FlownDemo(number, demo(number), demo(number).fly())
    assert entry(flown) in PAGE.read_text(encoding="utf-8"), "run `make docs`"


def test_one_is_told_in_lines_of_a_terminal_and_drawn(flown, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("mavfi.extras.demo.faults.Demo.fly", lambda _: flown.result)
    cli.demo(NUMBER)
    title, *lines = capsys.readouterr().out.splitlines()
    assert title == f" 1 ✗ {flown.demo.title}"
    assert " ".join(line.strip() for line in lines[:-2]) == flown.sentence
    assert max(map(len, lines[:-2])) <= 80
    assert lines[-2:] == [flown.demo.command, "wrote demo-1.png"]
    assert (tmp_path / "demo-1.png").stat().st_size > 10_000


def test_all_are_told_in_order_and_what_to_do_next_is_said(flown, capsys, monkeypatch):
    monkeypatch.setattr("mavfi.extras.demo.faults.Demo.fly", lambda _: flown.result)
    cli.demo()
    printed = capsys.readouterr().out
    positions = [printed.index(f"{number:2} ✗ {chosen.title}\n") for number, chosen in enumerate(DEMOS, start=1)]
    assert positions == sorted(positions)
    assert printed.splitlines()[-1].startswith("mavfi demo 3 draws one of them")


def test_a_number_that_is_not_there_is_refused():
    with pytest.raises(BadInputError, match="^demo 11: not known; allowed: 1 to 10$"):
        cli.demo(11)


@pytest.mark.long
def test_the_page_shows_a_flight_in_three_dimensions_when_asked(flown, browser, tmp_path):  # noqa: F811 - a fixture
    write_demo_page(tmp_path / "demo.html", [flown])
    browser.open(tmp_path / "demo.html")
    assert browser.count(".place img") == 1 and browser.count(".place canvas") == 0
    browser.click("button.open")
    assert browser.count(".place img") == 0 and browser.count(".place canvas") > 0
    browser.click("button.open")
    assert browser.count(".place img") == 1
