"""The success table at instruction level: flown small, with a detector, and every rate counted again in its ledger."""

import pytest

from mavfi.campaign.analysis import analyse
from mavfi.campaign.config import Campaign
from mavfi.campaign.replay import replay
from mavfi.campaign.run import run_campaign
from mavfi.campaign.store import Store
from mavfi.reports.campaign_report import write_report
from mavfi.reports.explain import explain, lines
from mavfi.reports.instruction_tables import INSTRUCTION_LEVEL
from mavfi.reports.tables import tables
from tests.hosts.missions import run_in_two_sittings

pytestmark = pytest.mark.slow


def campaign():
    return Campaign.model_validate({
        "name": "small", "environments": ["sparse"], "first_seed": 7, "flights": 2, "faults": 4, "law": "kernels",
        "kernels": {"names": ["point_cloud", "collision_check", "pid"], "which": "data", "share": "stage"},
        "null_runs": 0, "v_max": 6.0, "detectors": {"idle": {"detector": "none"}},
    })  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    directory = tmp_path_factory.mktemp("instructions")
    assert run_campaign(campaign(), directory, workers=1).complete
    return directory


def runs_of(directory):
    with Store.open(directory) as store:
        return list(store.runs(done=True))


def test_workers_and_stops_do_not_matter(folder, tmp_path):
    run_in_two_sittings(campaign(), tmp_path, flown=9)
    with Store.open(tmp_path) as again, Store.open(folder) as store:
        assert again.digest() == store.digest()


def test_each_stage_has_its_number_and_its_kernels_share_it(folder):
    kernels = [run.spec.target for run in runs_of(folder) if run.spec.setting == "fi"]
    assert {kernel: kernels.count(kernel) for kernel in kernels} == {"point_cloud": 2, "collision_check": 2, "pid": 4}


def test_arms_fly_the_same_faults(folder):
    fi, watched = (
        [(run.spec.fault, run.record["digest"]) for run in runs_of(folder) if run.spec.setting == setting]
        for setting in ("fi", "dr_idle")
    )
    assert len(fi) == 8
    assert fi == watched, "a detector that never alarms changes nothing"


def test_rates_are_those_of_the_ledger(folder):
    runs = runs_of(folder)
    table = next(t for t in tables(analyse(folder)) if t.title == INSTRUCTION_LEVEL)
    shown = {(row[0], row[1]): row[2].split()[-1] for row in table.rows if row[1] != "paper"}
    for label, setting in (("Golden run", "golden"), ("Injection run", "fi"), ("dr_idle", "dr_idle")):
        records = [run.record for run in runs if run.spec.setting == setting]
        restarted = sum(record["success"] for record in records)
        ended = sum(record["success"] and "due_end" not in record for record in records)
        if setting == "golden":
            assert shown[label, "here"] == f"{restarted}/{len(records)}"
        else:
            assert shown[label, "here, node restarts"] == f"{restarted}/{len(records)}"
            assert shown[label, "here, mission ends"] == f"{ended}/{len(records)}"
    assert table.rows[1] == ("Golden run", "paper", "95.0 %")


def test_the_report_names_the_level_and_runs_can_be_replayed(folder):
    block = next(path for path in write_report(folder, draw_run=False).files if path.name == "readme_block.md")
    text = block.read_text(encoding="utf-8")
    assert text.startswith(f"**{INSTRUCTION_LEVEL}**")
    assert "4 faults per stage" in text and "perception: point_cloud, collision_check; control: pid" in text
    chosen = next(run for run in runs_of(folder) if run.spec.setting == "dr_idle")
    assert replay(folder, chosen.spec.run_id).same
    assert chosen.spec.target in dict(lines(explain(folder, chosen.spec.run_id)))["kernel"]
