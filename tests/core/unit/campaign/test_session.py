"""Campaigns that fly together: missions with the same golden flights are one job; ledgers are as flown alone."""

import pytest

from mavfi.campaign.config import Scale, load_campaign
from mavfi.campaign.executors.executor import Done
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.mission import flights_of, plan_of, scenarios_of, share
from mavfi.campaign.plan import arms_of
from mavfi.campaign.run import run_campaign, run_campaigns
from mavfi.campaign.store import Store
from mavfi.flight.fast_forward import FastForward
from tests.core.unit.campaign.fakes import DETECTOR, TROUBLE, OneByOne, deaths, small


class InThisProcess:
    """An executor without workers, which notes its jobs."""

    forks, workers = True, 0

    def __init__(self):
        self.jobs = []

    def map(self, function, missions):
        for job in missions:
            self.jobs.append([(number, mission.environment, mission.seed) for number, mission in job])
            for item in function(job):
                yield job, [item]
            yield job, [Done()]


def digests(folders):
    found = []
    for folder in folders:
        with Store.open(folder) as store:
            assert store.complete
            found.append(store.digest())
    return found


def flights(name, environment):
    campaign = load_campaign(name)
    return flights_of(plan_of(campaign, {}, scenarios_of(campaign, arms_of(campaign))), environment)


def test_missions_share_golden_flights_unless_one_of_these_differs():
    dense = flights("table1", "dense")
    assert share(dense, flights("table1_instructions", "dense"))
    assert share(dense, flights("states", "dense")) and share(flights("states", "dense"), dense), "without detectors"
    assert share(dense, flights("platforms", "i9-9940x")), "the same mission by another name"
    assert not share(dense, flights("platforms", "cortex-a57"))
    assert not share(dense, flights("table1", "sparse"))
    assert not share(dense, dense | {"gaussian": "of another model"})


CAMPAIGNS = {
    "guarded": small(),
    "plain": small(name="plain", environments=["dense"], arms={}, missions=3),
    "twin": small(name="twin", environments=["dense"]),
    "hardened": small(name="hardened", environments=["dense"], mission={"autopilot": "hardened"}),
    "tuned": small(
        name="tuned", environments=["dense"], arms={"gaussian": {"detector": DETECTOR, "profile": "tuned"}}, missions=2
    ),
}


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    folder = tmp_path_factory.mktemp("alone")
    for name, campaign in CAMPAIGNS.items():
        run_campaign(campaign, folder / name, executor=LocalExecutor(1))
    return digests(folder / name for name in CAMPAIGNS)


def together(folder, executor=None, **options):
    """Fly all campaigns; returns the digests of their ledgers."""
    run_campaigns(
        {folder / name: one for name, one in CAMPAIGNS.items()}, executor=executor or LocalExecutor(2), **options
    )
    return digests(folder / name for name in CAMPAIGNS)


def test_ledgers_of_campaigns_flown_together_are_those_of_each_alone(tmp_path, alone):
    executor = InThisProcess()
    assert together(tmp_path, executor) == alone
    jobs = [[(number, where) for number, where, seed in job if seed == 10_000] for job in executor.jobs]
    shared = [(0, "dense"), (1, "dense"), (2, "dense")]
    assert [job for job in jobs if job] == [[(0, "sparse")], shared, [(3, "dense")], [(4, "dense")]]
    with Store.open(tmp_path / "twin") as store:
        walls = [run.wall_s for run in store.runs() if run.spec.kind != "golden"]
    assert walls == [0.0] * (36 + 3), "the faults are those of another campaign, whose runs were flown"
    assert together(tmp_path, again := InThisProcess()) == alone and again.jobs == [], "nothing is left"


def test_campaigns_flown_together_resume_to_the_same_ledgers(tmp_path, alone):
    seen = []

    def stop(directory, progress):
        seen.append((directory.name, progress.done))
        if len(seen) == 60:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        together(tmp_path, OneByOne(), progress=stop)
    assert {name for name, _ in seen} == set(CAMPAIGNS)
    assert together(tmp_path) == alone


def test_missions_of_a_worker_that_dies_are_flown_again(tmp_path, monkeypatch, alone):
    monkeypatch.setattr(TROUBLE, "golden_dies", deaths(tmp_path / "deaths", 2))
    assert together(tmp_path / "out") == alone
    assert not list((tmp_path / "deaths").iterdir())


@pytest.mark.slow
def test_faults_in_states_start_at_the_checkpoints_of_a_flight_that_counts_instructions(tmp_path, monkeypatch):
    simulated, flown = FastForward._simulated, []
    monkeypatch.setattr(FastForward, "_simulated", lambda *given: flown.append(1) or simulated(*given))
    monkeypatch.setattr("mavfi.campaign.run.is_compiled", lambda _: True)  # else it flies ahead
    monkeypatch.setattr("mavfi.flight.mission_flights.fly", None)  # one more golden flight, to count
    campaigns = {
        name: load_campaign(name).model_copy(update={"environments": ("dense",)}).resized(Scale(missions=1, faults=2))
        for name in ("table1", "states", "table1_instructions")
    }
    run_campaigns({tmp_path / "together" / name: one for name, one in campaigns.items()}, executor=InThisProcess())
    assert len(flown) == 1
    for name, campaign in campaigns.items():
        run_campaign(campaign, tmp_path / "alone" / name, executor=InThisProcess())
    assert len(flown) == 4
    assert digests(tmp_path / "together" / name for name in campaigns) == digests(
        tmp_path / "alone" / name for name in campaigns
    )
