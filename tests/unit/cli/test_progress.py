import re

import pytest
from rich.console import Console

from mavfi.cli import progress
from mavfi.cli.progress import Part, StudyBar, compiling
from mavfi.errors import BadInputError


@pytest.fixture
def clock(monkeypatch):
    """Seconds that the test sets."""
    now = [0.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now[0])
    return now


def test_the_time_left_is_that_of_all_parts_by_what_their_flights_take(capsys, clock):
    parts = {"states": Part(40, 100, 1.0), "instructions": Part(0, 60, 10.0)}
    with StudyBar("study paper", parts) as bar:
        bar.begin("states", "campaign table1")
        clock[0] = 500.0
        bar.show(41, 100)  # kernels were compiled first
        clock[0] = 560.0
        bar.show(71, 100)  # 30 flights took 60 s: 2 s for one of this part, so 20 s for one of the next
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert line.startswith("study paper, campaign table1 (1 of 2) 71/160 flights")
    assert "20 min 58 s left" in line, "29 x 2 s + 60 x 20 s"


def test_a_few_flights_give_no_estimate(capsys, clock):
    with StudyBar("study paper", {"states": Part(40, 100, 1.0)}) as bar:
        for done in (41, 42, 50):
            clock[0] += 20.0
            bar.show(done, 100)
    stderr = capsys.readouterr().err
    assert "50/100 flights  estimating the time left" in stderr and "min" not in stderr


def test_parts_follow_each_other_in_one_count(capsys, clock):
    parts = {"states": Part(0, 10, 1.0), "bits": Part(5, 10, 1.0)}
    with StudyBar("study s", parts) as bar:
        for place, (name, start) in enumerate({"states": 0, "bits": 5}.items()):
            bar.begin(name, name)
            clock[0] = 20.0 * (place + 1)
            bar.show(start + 1, 10)
            bar.show(10, 10)
    counts = re.findall(r"(\d+)/20 flights", capsys.readouterr().err)
    assert counts[-1] == "20" and [int(count) for count in counts] == sorted(map(int, counts))


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
