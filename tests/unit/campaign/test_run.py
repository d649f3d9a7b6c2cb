import os
import signal
import time
from dataclasses import asdict

import pytest

from mavfi.campaign import run as run_module
from mavfi.campaign.run import run_campaign, status, stored_campaign
from mavfi.campaign.store import Store
from mavfi.errors import BadInputError
from tests.unit.campaign import fakes
from tests.unit.campaign.fakes import FAKE, small


def digest(directory) -> str:
    with Store.open(directory) as store:
        return store.digest()


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    directory = tmp_path_factory.mktemp("campaign")
    reports = []
    end = run_campaign(small(), directory, workers=1, tools=FAKE, progress=reports.append)
    return directory, end, reports


def test_everything_is_flown_and_told(flown):
    directory, end, reports = flown
    assert end.complete
    assert end.done == end.total == 2 * (2 * (4 + 18) + 3)
    assert end.settings["golden"] == (8, 8, 8)
    assert end.settings["fi"][:2] == (36, 36)
    assert sorted({report.done for report in reports}) == list(range(end.total + 1))
    assert reports[-1].flown == end.total
    assert reports[-1].rate > 0
    assert reports[-1].remaining_s == 0
    assert status(directory) == end
    assert set(asdict(end)) == {"done", "total", "settings"}, "a sitting is over: nothing to tell of its speed"
    with Store.open(directory) as store:
        assert stored_campaign(store) == small()
        assert all(run.record["end"] == "flown" for run in store.runs())


def test_two_workers_give_the_same_content(flown, tmp_path):
    run_campaign(small(), tmp_path, workers=2, tools=FAKE)
    assert digest(tmp_path) == digest(flown[0])


def test_another_seed_gives_other_content(flown, tmp_path):
    run_campaign(small(first_seed=20_000), tmp_path, workers=1, tools=FAKE)
    assert digest(tmp_path) != digest(flown[0])


@pytest.mark.slow
@pytest.mark.parametrize("stop_after", [0, 3, 16, 40])
def test_ctrl_c_stops_cleanly_and_the_same_call_goes_on(flown, tmp_path, stop_after):
    def interrupt(progress):
        if progress.flown == stop_after:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(5)  # the signal arrives in here

    with pytest.raises(KeyboardInterrupt):
        run_campaign(small(), tmp_path, workers=2, tools=FAKE, progress=interrupt)
    assert status(tmp_path).done == stop_after
    reports = []
    end = run_campaign(small(), tmp_path, workers=1, tools=FAKE, progress=reports.append)
    assert reports[-1].flown == end.total - stop_after
    assert digest(tmp_path) == digest(flown[0])


def test_a_finished_campaign_flies_nothing_again(flown):
    directory, _, _ = flown
    before = digest(directory)
    reports = []
    run_campaign(small(), directory, workers=1, tools=FAKE, progress=reports.append)
    assert max(report.flown for report in reports) == 0
    assert digest(directory) == before


@pytest.mark.slow
def test_the_death_of_a_worker_is_survived(flown, tmp_path, monkeypatch):
    monkeypatch.setattr(fakes.TROUBLE, "dies", fakes.deaths(tmp_path / "deaths", 1))
    run_campaign(small(), tmp_path / "out", workers=2, tools=FAKE)
    assert digest(tmp_path / "out") == digest(flown[0])


@pytest.mark.slow
def test_a_run_that_dies_each_time_is_due_and_the_rest_is_flown(tmp_path, monkeypatch):
    monkeypatch.setattr(fakes.TROUBLE, "dies", fakes.deaths(tmp_path / "deaths", 100))
    campaign = small(environments=["sparse"], faults=2, null_runs=0, detectors={})
    end = run_campaign(campaign, tmp_path / "out", workers=2, tools=FAKE)
    assert end.complete
    with Store.open(tmp_path / "out") as store:
        for run in store.runs():
            dies = run.spec.seed == 10_001 and run.spec.fault is not None
            assert run.record["end"] == ("due" if dies else "flown")
            assert ("exit code 9" in run.note) == dies


def test_an_exception_is_recorded_as_unknown(tmp_path, monkeypatch):
    monkeypatch.setattr(fakes.TROUBLE, "raises", 10_002)
    end = run_campaign(small(), tmp_path, workers=1, tools=FAKE)
    with Store.open(tmp_path) as store:
        unknown = [run for run in store.runs() if run.record["end"] == "unknown"]
    assert end.complete
    assert {run.spec.seed for run in unknown} == {10_002}
    assert all("a mistake of ours" in run.note for run in unknown)


def test_every_fault_is_stored_before_the_first_of_them_flies(tmp_path):
    golden = 2 * 2 * 4

    def interrupt(progress):
        if progress.done == golden and "fi" in progress.settings:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_campaign(small(), tmp_path, workers=1, tools=FAKE, progress=interrupt)
    end = status(tmp_path)
    assert end.done == golden
    assert sum(planned for planned, _, _ in end.settings.values()) == end.total


def test_bad_input_is_found_before_anything_is_written(tmp_path):
    directory = tmp_path / "out"
    for campaign, workers, message in (
        (small(environments=["venus"]), 1, "environment 'venus'"),
        (small(stack="soft"), 1, "stack 'soft'"),
        (small(detectors={"x": {"detector": "nonsense"}}), 1, "detector 'nonsense'"),
        (small(), 0, "workers: 0"),
    ):
        with pytest.raises(BadInputError, match=message):
            run_campaign(campaign, directory, workers=workers, tools=FAKE)
    assert not directory.exists()


def test_another_campaign_or_model_is_refused(flown, tmp_path):
    directory, _, _ = flown
    before = digest(directory)
    with pytest.raises(BadInputError, match="differs in: campaign"):
        run_campaign(small(faults=7), directory, workers=1, tools=FAKE)
    with pytest.raises(BadInputError, match="differs in: models"):
        run_campaign(small(), directory, workers=1, tools=FAKE, models_dir=tmp_path / "retrained")
    assert digest(directory) == before


def test_versions_are_not_mixed_within_a_campaign(tmp_path, monkeypatch):
    def interrupt(progress):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_campaign(small(), tmp_path, workers=1, tools=FAKE, progress=interrupt)
    monkeypatch.setattr(run_module, "__version__", "99.0")
    with pytest.raises(BadInputError, match="was begun with mavfi .*, here is 99.0"):
        run_campaign(small(), tmp_path, workers=1, tools=FAKE)


def test_the_kind_of_map_reaches_every_scenario():
    scenarios = run_module.campaign_scenarios(small(map="octree"), FAKE).values()
    assert {scenario.map.kind for scenario in scenarios} == {"octree"}
    assert {s.map.kind for s in run_module.campaign_scenarios(small(), FAKE).values()} == {"dense"}


def test_the_vehicle_of_a_campaign_takes_the_place_of_the_environments():
    scenarios = run_module.campaign_scenarios(small(vehicle="small_quad"), FAKE).values()
    assert {scenario.vehicle.name for scenario in scenarios} == {"small_quad"}
    assert {s.vehicle.name for s in run_module.campaign_scenarios(small(), FAKE).values()} == {"airsim_quad"}
