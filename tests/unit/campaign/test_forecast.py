"""What is expected of a campaign: from its ledger, or from figures that are named as assumed."""

import pytest

from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.forecast import ASSUMED, forecast
from mavfi.campaign.mission import plan_of
from mavfi.campaign.run import run_campaign
from mavfi.campaign.store import FILE, Store
from tests.unit.campaign.fakes import small


def stop_at(number):
    def stop(progress):
        if progress.flown == number:
            raise KeyboardInterrupt

    return stop


def test_runs_are_those_of_the_plan(tmp_path):
    found = forecast(plan_of(small(), {}, {}), tmp_path, 2)
    assert (found.missions, found.golden, found.injected) == (8, 16, 78)
    assert (found.measured, found.seconds, found.ledger_bytes) == (False, None, None), "nothing is assumed of this host"


@pytest.mark.parametrize("level", ["state", "instruction"])
def test_what_is_assumed_is_shared_by_workers(tmp_path, level):
    kernels = {"kernels": ["pid"]} if level == "instruction" else {}
    plan = plan_of(small(host="local", sampling={"level": level, **kernels}, arms={}), {}, {})
    golden, injected, each = ASSUMED["local", level]
    one, many = (forecast(plan, tmp_path, workers) for workers in (1, 100))
    assert one.seconds == one.golden * golden + one.injected * injected
    assert many.seconds == one.seconds / one.missions, "never more workers than missions"
    assert one.ledger_bytes == each * (one.golden + one.injected)
    assert not one.measured


def test_what_is_in_the_ledger_decides(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        run_campaign(small(), tmp_path, executor=LocalExecutor(1), progress=stop_at(60))
    with Store.open(tmp_path) as store:
        walls, counts = store.wall_times(), store.counts()
    golden = counts["golden"][1] + counts["golden_gaussian"][1]
    injected = sum(done for _, done, _ in counts.values()) - golden
    assert 60 <= golden + injected < 94, "runs are kept in batches"
    found = forecast(plan_of(small(), {}, {}), tmp_path, 1)
    means = {kind: wall_s / number for kind, (number, wall_s) in walls.items()}
    assert walls[True][0] == golden and walls[False][0] == injected
    assert found.measured
    assert found.seconds == pytest.approx((16 - golden) * means[True] + (78 - injected) * means[False])
    run_campaign(small(), tmp_path, executor=LocalExecutor(1))
    done = forecast(plan_of(small(), {}, {}), tmp_path, 1)
    assert done.seconds == 0.0 and done.ledger_bytes == (tmp_path / FILE).stat().st_size
    assert found.ledger_bytes == pytest.approx(done.ledger_bytes, rel=0.5)
