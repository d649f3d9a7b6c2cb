import pytest
from rich.console import Console

from mavfi.campaign.ledger import Progress
from mavfi.errors import BadInputError
from mavfi.report import progress
from mavfi.report.progress import Bar, compiling


@pytest.fixture
def clock(monkeypatch):
    """Seconds that the test sets."""
    now = [0.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now[0])
    return now


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


@pytest.mark.parametrize("terminal", [True, False])
def test_a_cache_is_cold_until_a_flight_has_ended(terminal, monkeypatch, tmp_path, capsys):
    (tmp_path / "some.nbc").touch()  # compiled by a command that does not fly
    monkeypatch.setattr("mavfi.numerics.jit.code_folder", lambda: tmp_path)
    out = Console(stderr=True, force_terminal=terminal, width=100)
    monkeypatch.setattr("mavfi.report.progress.console", lambda **_: out)
    with pytest.raises(BadInputError), compiling(flight=True):
        raise BadInputError("refused")
    capsys.readouterr()
    for cold in (True, False):
        with compiling(flight=True) as found:
            assert found is cold
            (tmp_path / f"{cold}.nbc").touch()
        shown = capsys.readouterr().err
        assert ("compiling kernels for this machine" in shown) is (cold and terminal)
        assert ("1 of 134 functions" in shown) is (cold and terminal)
    with compiling() as found:
        assert not found
