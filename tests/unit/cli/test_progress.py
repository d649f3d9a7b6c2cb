import re

import pytest
from rich.console import Console

from mavfi.campaign.session import Progress
from mavfi.campaign.steps import Steps
from mavfi.cli import progress
from mavfi.cli.progress import Bar, Part, StudyBar, compiling
from mavfi.errors import BadInputError


@pytest.fixture
def clock(monkeypatch):
    """Seconds that the test sets."""
    now = [0.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now[0])
    return now


@pytest.fixture
def study(tmp_path):
    """Makes the bar of a study, and keeps its steps."""
    return lambda parts, name="paper": StudyBar(f"study {name}", parts, Steps(tmp_path))


def tasks(total, seconds):
    return Part(0, total, seconds, flights=False)


def test_the_time_left_is_that_of_all_parts_by_what_their_units_take(capsys, clock, study):
    parts = {"states": Part(40, 100, 1.0), "instructions": Part(0, 60, 10.0), "tables": tasks(3, 100.0)}
    with study(parts) as bar, bar.timed("campaign table1", "states"):
        clock[0] = 500.0
        bar.show(41, 100)  # kernels were compiled first
        clock[0] = 560.0
        bar.show(71, 100)  # 30 flights took 60 s: 2 s for one of this part, so 20 s for one of the next
        line = capsys.readouterr().err.strip().splitlines()[-1]
    assert line.startswith("study paper, campaign table1 (1 of 3) 7 %, 71/160 flights"), "71 s of 1000 s"
    assert "30 min 58 s left" in line, "29 x 2 s + 60 x 20 s + 3 x 200 s"


def test_campaigns_that_fly_together_have_one_count(capsys, clock, tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    with Bar("bench: 2 parts", "runs") as bar:
        bar.show_campaigns(one, Progress(4, 20))  # of an earlier session
        bar.show_campaigns(two, Progress(0, 40))
        bar.show_campaigns(two, Progress(1, 40, flown=1))  # kernels were compiled first
        clock[0] = 20.0
        bar.show_campaigns(one, Progress(14, 20, flown=10))
        line = capsys.readouterr().err.strip().splitlines()[-1]
    assert line.startswith("bench: 2 parts 15/60 runs  0.50 runs/s") and "1 min 30 s left" in line


def test_a_few_flights_give_no_estimate(capsys, clock, study):
    with study({"states": Part(40, 100, 1.0)}) as bar, bar.timed("campaign table1", "states"):
        for done in (41, 42, 50):
            clock[0] += 20.0
            bar.show(done, 100)
        stderr = capsys.readouterr().err
    assert "50 %, 50/100 flights  estimating the time left" in stderr and "min" not in stderr


def test_parts_follow_each_other_in_one_count(capsys, clock, study):
    parts = {"states": Part(0, 10, 1.0), "bits": Part(5, 10, 1.0)}
    with study(parts) as bar:
        for place, (name, start) in enumerate({"states": 0, "bits": 5}.items()):
            with bar.timed(name, name):
                clock[0] = 20.0 * (place + 1)
                bar.show(start + 1, 10)
                bar.show(10, 10)
    counts = re.findall(r"(\d+)/20 flights", capsys.readouterr().err)
    assert counts[-1] == "20" and [int(count) for count in counts] == sorted(map(int, counts))


def test_what_is_no_flight_has_its_share_and_time_and_all_of_it_ends_at_100_percent(capsys, clock, study):
    parts = {"compilation": tasks(10, 10.0), "states": Part(0, 100, 1.0), "tables": tasks(2, 50.0)}
    with study(parts) as bar:
        with bar.timed("compilation", "compilation"):
            for done in range(1, 5):
                clock[0] += 20.0
                bar.show(done, 10)
            assert "13 %, 0/100 flights  8 min 40 s left" in capsys.readouterr().err, "two times 260 s"
            bar.show(10, 10)  # the rest was in the cache
        with bar.timed("campaign table1", "states"):
            for done in range(1, 101):
                clock[0] += 1.0
                bar.show(done, 100)
        last = capsys.readouterr().err.splitlines()[-1]
        assert "63 %, 90/100 flights  1 min 50 s left" in last, "the pace is that of flights as soon as some have flown"
        with bar.timed("tables and figures", "tables"):
            clock[0] += 50.0
            bar.show(1, 2)
            assert "83 %, 100/100 flights  50 s left" in capsys.readouterr().err
            bar.show(2, 2)
        assert capsys.readouterr().err == "study paper, tables and figures (3 of 3) 100 %, 100/100 flights\n", "once"
    assert list(bar.steps.seconds) == ["compilation", "campaign table1", "tables and figures"]
    assert bar.steps.seconds["campaign table1"] == 100.0


def test_a_part_that_has_less_to_do_than_expected_is_over_when_it_ends(capsys, clock, study):
    parts = {"states": Part(0, 100, 1.0), "nothing": tasks(0, 1.0), "page": tasks(12, 5.0)}
    with study(parts) as bar:
        with bar.timed("campaign table1", "states"):
            bar.show(40, 100)  # its rates are known well enough
        for name in ("nothing", "page"):
            with bar.timed(name, name):
                pass
    assert capsys.readouterr().err.splitlines()[-1] == "study paper, page (3 of 3) 100 %, 40/40 flights"


def test_a_part_that_is_stopped_is_not_shown_as_done(capsys, clock, study):
    bar = study({"states": Part(0, 100, 1.0)})
    with pytest.raises(KeyboardInterrupt), bar, bar.timed("campaign table1", "states"):
        raise KeyboardInterrupt
    assert capsys.readouterr().err == "" and list(bar.steps.seconds) == ["campaign table1"]


def test_in_a_terminal_the_bar_is_the_share_of_the_expected_time(monkeypatch, clock, study, capsys):
    out = Console(stderr=True, force_terminal=True, width=140)
    monkeypatch.setattr("mavfi.cli.progress.console", lambda **_: out)
    with study({"states": Part(0, 100, 1.0), "page": tasks(1, 300.0)}) as bar, bar.timed("campaign table1", "states"):
        bar.show(100, 100)
        (task,) = bar._bar.tasks  # private: the text has colours and moves of the cursor between its parts
        assert (task.percentage, task.fields["counts"]) == (25.0, "25 %, 100/100 flights")
    assert "study paper, campaign table1 (1 of 2)" in capsys.readouterr().err


@pytest.mark.parametrize("terminal", [True, False])
def test_a_cache_is_cold_until_a_flight_has_ended(terminal, monkeypatch, tmp_path, capsys):
    (tmp_path / "some.nbc").touch()  # compiled by a command that does not fly
    monkeypatch.setattr("mavfi.numerics.jit.code_folder", lambda: tmp_path)
    out = Console(stderr=True, force_terminal=terminal, width=100)
    monkeypatch.setattr("mavfi.cli.progress.console", lambda **_: out)
    with pytest.raises(BadInputError), compiling(flight=True):
        raise BadInputError("refused")
    capsys.readouterr()
    for cold in (True, False):
        with compiling(flight=True) as found:
            assert found is cold
        assert ("compiling kernels for this machine" in capsys.readouterr().err) is (cold and terminal)
    with compiling() as found:
        assert not found
