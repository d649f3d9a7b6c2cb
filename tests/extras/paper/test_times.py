import pytest

from mavfi.campaign.store import Run
from mavfi.extras.paper.report import time_table
from tests.core.unit.analysis.handmade import flown, golden, injected, null, runs


def timed(run, wall_s):
    return Run(run.spec, run.record, wall_s=wall_s)


def test_time_by_campaign_and_all_together():
    one = runs(timed(golden(1), 60.0), timed(injected(1, flown()), 30.0), timed(injected(2, flown()), 90.0), name="one")
    two = runs(timed(golden(1), 90.0), timed(null(1, flown()), 30.0), name="two")
    first, second, total = time_table({"a": one, "b": two}).entries()
    assert (first["golden"], first["golden_s"], first["faulty"], first["faulty_s"]) == (1, 1.0, 2, 2.0)
    assert first["faulty_mean_s"] == 60.0 and second["faulty_mean_s"] is None
    assert (second["faulty"], second["all_s"]) == (0, 2.0), "a null run has no fault"
    assert (total["campaign"], total["all_s"]) == ("all", pytest.approx(5.0))
