"""A campaign that is flown mission by mission leaves the ledger that it leaves in two phases."""

import os
import signal
import time

import pytest

from mavfi.campaign import worker
from mavfi.campaign.config import Campaign
from mavfi.campaign.plan import PHASE_GOLDEN, Arm, RunSpec, plan_injected, plan_world
from mavfi.campaign.run import run_campaign, status
from mavfi.campaign.store import Store
from mavfi.campaign.worker import Task, Tools
from tests.unit.campaign import fakes
from tests.unit.campaign.fakes import FORKING, FakeFamily, golden_profile, small


def digest(directory) -> str:
    with Store.open(directory) as store:
        assert store.complete
        return store.digest()


@pytest.fixture(scope="module")
def long_way(tmp_path_factory):
    directory = tmp_path_factory.mktemp("long")
    run_campaign(small(), directory, workers=1, tools=FORKING, forking=False)
    return directory


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_the_ledger_is_the_same(long_way, tmp_path, workers):
    reports = []
    end = run_campaign(small(), tmp_path, workers=workers, tools=FORKING, progress=reports.append)
    assert end == status(long_way)
    assert sorted({report.done for report in reports}) == list(range(end.total + 1))
    assert digest(tmp_path) == digest(long_way)


def test_the_flights_of_a_mission_are_flown_by_one_worker(tmp_path, monkeypatch):
    (tmp_path / "flown").mkdir()
    monkeypatch.setattr(FakeFamily, "flown", tmp_path / "flown")
    run_campaign(small(), tmp_path / "out", workers=2, tools=FORKING)
    here = f".{os.getpid()}"  # the warming up
    missions = [path.stem for path in (tmp_path / "flown").iterdir() if path.suffix != here]
    assert sorted(missions) == sorted(
        f"{name}-{seed}" for name in ("sparse", "dense") for seed in range(10_000, 10_004)
    )
    assert not worker._families, "the parent keeps none"


@pytest.mark.slow
@pytest.mark.parametrize("stop_after", [0, 1, 7, 40])
@pytest.mark.parametrize("forking", [True, False])
def test_a_stopped_campaign_is_gone_on_with_either_way(long_way, tmp_path, stop_after, forking):
    def interrupt(progress):
        if progress.flown == stop_after:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(5)  # the signal arrives in here

    with pytest.raises(KeyboardInterrupt):
        run_campaign(small(), tmp_path, workers=2, tools=FORKING, progress=interrupt, forking=not forking)
    assert status(tmp_path).done == stop_after
    run_campaign(small(), tmp_path, workers=1, tools=FORKING, forking=forking)
    assert digest(tmp_path) == digest(long_way)


def test_a_campaign_stopped_while_worlds_are_planned_has_no_gap(long_way, tmp_path, monkeypatch):
    planned = []

    def stop_after_two(self, phase, specs):
        planned.append(specs)
        if len(planned) > 3:
            raise KeyboardInterrupt
        return plan_part(self, phase, specs)

    plan_part = Store.plan_part
    monkeypatch.setattr(Store, "plan_part", stop_after_two)
    with pytest.raises(KeyboardInterrupt):
        run_campaign(small(), tmp_path, workers=1, tools=FORKING)
    monkeypatch.undo()
    run_campaign(small(), tmp_path, workers=1, tools=FORKING, forking=False)
    assert digest(tmp_path) == digest(long_way)


@pytest.mark.slow
@pytest.mark.parametrize("deaths", [1, 5])
def test_the_death_of_a_worker_takes_no_other_flight_with_it(long_way, tmp_path, monkeypatch, deaths):
    monkeypatch.setattr(fakes.TROUBLE, "dies", fakes.deaths(tmp_path / "deaths", deaths))
    run_campaign(small(), tmp_path / "out", workers=2, tools=FORKING)
    assert digest(tmp_path / "out") == digest(long_way)


@pytest.mark.slow
def test_a_run_that_dies_each_time_is_due_and_its_siblings_are_flown(tmp_path, monkeypatch):
    monkeypatch.setattr(fakes.TROUBLE, "dies", fakes.deaths(tmp_path / "deaths", 100))
    campaign = small(environments=["sparse"], faults=2, null_runs=0, detectors={})
    run_campaign(campaign, tmp_path / "out", workers=2, tools=FORKING)
    with Store.open(tmp_path / "out") as store:
        ends = {run.spec.run_id: run.record["end"] for run in store.runs()}
        dead = {run.spec.run_id for run in store.runs() if run.spec.seed == 10_001 and run.spec.fault is not None}
    assert dead and {run_id for run_id, end in ends.items() if end == "due"} == dead
    assert set(ends.values()) == {"due", "flown"}


@pytest.mark.slow
def test_a_mission_whose_golden_run_dies_is_planned_all_the_same(tmp_path, monkeypatch):
    def die(task):
        if task.spec.fault is None and task.spec.seed == 10_001:
            os._exit(9)
        return really(task)

    really = worker.fly_task
    outs = []
    for forking in (True, False):
        out = tmp_path / str(forking)
        monkeypatch.setattr(worker, "fly_task", die)
        monkeypatch.setattr(worker, "fly_forked", die)
        monkeypatch.setattr("mavfi.campaign.run._Sitting._warm_up", lambda *_: None)
        run_campaign(small(detectors={}, null_runs=0), out, workers=2, tools=FORKING, forking=forking)
        outs.append(digest(out))
    assert outs[0] == outs[1]


@pytest.mark.slow
def test_an_exception_is_recorded_as_the_long_way_records_it(tmp_path, monkeypatch):
    monkeypatch.setattr(fakes.TROUBLE, "raises", 10_002)
    for forking in (True, False):
        run_campaign(small(), tmp_path / str(forking), workers=1, tools=FORKING, forking=forking)
    assert digest(tmp_path / "True") == digest(tmp_path / "False")


def test_a_worker_keeps_few_families_and_none_that_failed(monkeypatch):
    scenario = FORKING.make_scenario(
        "sparse", 1, stack="published", platform="i9-9940x", planner="rrt_connect", v_max=None
    )
    made = []
    tools = Tools(fakes.fly, fakes.load_detector, FORKING.make_scenario, lambda s: made.append(s) or FakeFamily(s))
    worker.forget_families()
    for seed in (1, 2, 1, 3, 1, 2):
        spec = RunSpec(PHASE_GOLDEN, "golden", "sparse", seed, "key")
        found = worker.run_task(Task(spec, scenario.model_copy(update={"seed": seed}), tools, forking=True))
        assert found.record["end"] == "flown" and found.profile is not None
    assert [scenario.seed for scenario in made] == [1, 2, 3, 2], "the one that was not asked for longest is given up"
    assert len(worker._families) == worker.MOST_FAMILIES
    monkeypatch.setattr(FakeFamily, "fly", lambda *_: 1 / 0)
    found = worker.run_task(Task(spec, scenario, tools, forking=True))
    assert found.record["end"] == "flown", "the long way says what is recorded"
    assert len(worker._families) == worker.MOST_FAMILIES - 1
    worker.forget_families()


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"faults": 3, "flights": 4},
        {"null_runs": 9, "strata": {"mantissa": 1}},
        {
            "law": "groups",
            "groups": [{"name": "a", "sites": ["control.command.vx"]}, {"name": "b", "sites": ["planning.waypoint.x"]}],
        },
    ],
)
def test_the_plans_of_the_missions_are_the_plan(changes):
    campaign: Campaign = small(**changes)
    arms = [Arm(), Arm("gaussian", campaign.detectors["gaussian"], "hash")]
    keys = {"sparse": "one", "dense": "two"}
    profiles = {(name, seed): golden_profile(seed) for name in keys for seed in campaign.seeds if seed != 10_002}
    whole = plan_injected(campaign, keys, arms, profiles)
    places = {}
    for name in keys:
        for seed in campaign.seeds:
            found = plan_world(campaign, keys, arms, (name, seed), profiles.get((name, seed)))
            assert {(spec.environment, spec.seed) for spec in found.values()} <= {(name, seed)}
            places |= found
    assert [places[place] for place in sorted(places)] == whole
    assert sorted(places) == list(range(len(whole)))
