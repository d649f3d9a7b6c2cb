"""A campaign with the law `kernels`: the same ledger for any workers and after a stop; its report."""

import pytest

from mavfi.campaign.analysis import analyse
from mavfi.campaign.config import Campaign
from mavfi.campaign.kernel_profiles import read_kernel_profiles
from mavfi.campaign.kernel_rows import read_kernel_runs, read_line_counts
from mavfi.campaign.replay import replay
from mavfi.campaign.run import run_campaign
from mavfi.campaign.store import Store
from mavfi.reports.explain import explain, lines
from mavfi.reports.markdown import report
from tests.hosts.missions import run_in_two_sittings

pytestmark = pytest.mark.slow


def campaign():
    return Campaign.model_validate({
        "name": "small", "environments": ["sparse"], "first_seed": 7, "flights": 2, "faults": 3, "law": "kernels",
        "kernels": {"names": ["pid", "rrt"], "which": "data"}, "null_runs": 0, "v_max": 6.0,
    })  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    directory = tmp_path_factory.mktemp("kernels")
    assert run_campaign(campaign(), directory, workers=1).complete
    return directory


def digest(directory):
    with Store.open(directory) as store:
        assert store.complete
        return store.digest()


def test_workers_and_stops_do_not_matter(folder, tmp_path):
    run_in_two_sittings(campaign(), tmp_path, flown=6)
    assert digest(tmp_path) == digest(folder)


def test_rows_counts_and_report(folder):
    with Store.open(folder) as store:
        runs = read_kernel_runs(store)
        profiles = read_kernel_profiles(store)
        counts = read_line_counts(store)
    assert [run.kernel for run in runs].count("pid") == [run.kernel for run in runs].count("rrt") == 3
    assert all(run.outcome in ("masked", "sdc", "exception") for run in runs), "data neither crash nor hang"
    assert all(run.same_flight for run in runs if run.outcome == "masked")
    assert {kernel: len(found) for kernel, found in profiles.items()} == {"pid": 2, "rrt": 2}
    for kernel, found in profiles.items():
        assert sum(n for (name, _, _), n in counts.items() if name == kernel) == sum(p.instructions for p in found)
    analysis = analyse(folder)
    assert [entry["n"] for entry in analysis["kernels"]["table"]] == [3, 3]
    text = report(analysis, [], "2026-01-01", {})
    assert "IR level, not machine level" in text
    assert "3 faults per kernel" in text


def test_runs_can_be_replayed_and_explained(folder):
    with Store.open(folder) as store:
        chosen = max(read_kernel_runs(store), key=lambda run: run.outcome == "sdc")
    assert replay(folder, chosen.run_id).same
    story = dict(lines(explain(folder, chosen.run_id)))
    assert f"{chosen.file}:{chosen.line}" in story["source line"]
    assert chosen.kernel in story["kernel"]
