"""Campaigns that fly together: missions with the same golden flights are one job; ledgers are as flown alone."""

import pytest

from mavfi.campaign.begin import begin
from mavfi.campaign.config import load_campaign
from mavfi.campaign.executors.executor import Done
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.mission import flights_of, share
from mavfi.campaign.resolve import resolve
from mavfi.campaign.run import run_campaigns
from mavfi.campaign.store import Store
from tests.campaigns import run_campaign
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
    ledger_digests = []
    for folder in folders:
        with Store.open(folder) as store:
            assert store.complete
            ledger_digests.append(store.digest())
    return ledger_digests


def flights(name, environment):
    return flights_of(resolve(load_campaign(name)).with_scenarios(), environment)


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
    campaigns = {folder / name: begin(campaign, folder / name) for name, campaign in CAMPAIGNS.items()}
    run_campaigns(campaigns, executor=executor or LocalExecutor(2), **options)
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
