import pytest

from mavfi.campaign.ledger import Progress
from mavfi.report import progress
from mavfi.report.progress import Bar


@pytest.fixture
def clock(monkeypatch):
    """Seconds that the test sets."""
    now = [0.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now[0])
    return now


def test_campaigns_that_fly_together_have_one_count(capsys, clock, tmp_path):
    first, two = tmp_path / "one", tmp_path / "two"
    with Bar("bench: 2 parts", "runs") as bar:
        bar.show_campaigns(first, Progress(4, 20))  # of an earlier session
        bar.show_campaigns(two, Progress(0, 40))
        bar.show_campaigns(two, Progress(1, 40, flown=1))  # kernels were compiled first
        clock[0] = 20.0
        bar.show_campaigns(first, Progress(14, 20, flown=10))
        line = capsys.readouterr().err.strip().splitlines()[-1]
    assert line.startswith("bench: 2 parts 15/60 runs  0.50 runs/s") and "1 min 30 s left" in line
