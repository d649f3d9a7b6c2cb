import shutil

import pytest

from mavfi.campaign.replay import replay, resolve_stored, setup_of_run
from mavfi.campaign.store import Store
from mavfi.detectors.registry import Loaded
from mavfi.errors import BadInputError, SpecMismatchError
from mavfi.extras.hardening.plan import load_plan, save_plan
from mavfi.flight import compose
from tests.campaigns import run_campaign
from tests.core.unit.campaign.fakes import TROUBLE, FakeDetector, OneByOne, small


def planned_with_a_model(monkeypatch, sha):
    monkeypatch.setattr(compose, "detector_for", lambda *_: Loaded(FakeDetector(), sha))


@pytest.fixture(scope="module")
def directory(tmp_path_factory):
    directory = tmp_path_factory.mktemp("campaign")
    with pytest.MonkeyPatch.context() as patch:
        planned_with_a_model(patch, "0123456789abcdef")
        arms = {"gaussian": {"detector": "gaussian", "wind": 2.0}}
        run_campaign(small(environments=["dense"], arms=arms), directory)
    return directory


@pytest.fixture(autouse=True)
def _model(monkeypatch):
    planned_with_a_model(monkeypatch, "0123456789abcdef")


def a_run(directory, setting):
    with Store.open(directory) as store:
        return next(run for run in store.runs() if run.spec.setting == setting)


@pytest.mark.parametrize("setting", ["golden_gaussian", "fi", "dr_gaussian", "null"])
def test_the_same_flight_comes_out(directory, setting):
    run = a_run(directory, setting)
    again = replay(directory, run.spec.run_id)
    assert again.same
    assert again.run == run
    assert again.record.status == run.record.status
    assert again.record.digest == run.record.digest


def test_another_flight_is_reported(directory, monkeypatch):
    monkeypatch.setattr(TROUBLE, "stray", 1e-9)
    assert not replay(directory, a_run(directory, "fi").spec.run_id).same


def test_another_model_is_refused_and_only_where_it_matters(directory, monkeypatch):
    planned_with_a_model(monkeypatch, "trained since")
    with pytest.raises(
        SpecMismatchError, match="planned with the model 0123456789ab, but the shipped folder holds trained"
    ):
        replay(directory, a_run(directory, "dr_gaussian").spec.run_id)
    assert replay(directory, a_run(directory, "fi").spec.run_id).same


@pytest.fixture
def protected(tmp_path):
    """The ledger of a campaign with a protection plan, and the file of the plan."""
    file = tmp_path / "plan.yaml"
    save_plan(load_plan("ten_percent"), file)
    campaign = small(missions=1, faults=1, arms={"safe": {"protection": str(file)}})
    run_campaign(campaign, tmp_path / "out", executor=OneByOne())
    return tmp_path / "out", file, campaign


def test_runs_are_flown_again_with_the_plan_of_the_ledger(protected, tmp_path):
    directory, file, _ = protected
    shutil.copytree(directory, tmp_path / "there")
    for content in ("functions: []", None):  # changed, moved
        file.unlink() if content is None else file.write_text(content)
        for ledger in (directory, tmp_path / "there"):
            with Store.open(ledger) as store:
                protected_run = next(run for run in store.runs() if run.spec.setting == "fi_safe")
                setup = setup_of_run(resolve_stored(store), store, protected_run.spec)
                assert setup.scenario.protection == load_plan("ten_percent").bare
                assert setup.scenario.seed == protected_run.spec.seed
            assert replay(ledger, protected_run.spec.run_id).same


def test_a_campaign_does_not_continue_with_another_plan(protected):
    directory, file, campaign = protected
    file.write_text("functions: []")
    with pytest.raises(BadInputError, match=r"differs in: scenarios\.platform, scenarios\.protection\)"):
        run_campaign(campaign, directory, executor=OneByOne())
    file.unlink()
    with pytest.raises(BadInputError, match=f"^{file}: "):
        run_campaign(campaign, directory, executor=OneByOne())


def test_a_plan_of_another_compiler_is_refused_and_names_the_ledger(protected, monkeypatch):
    directory, _, _ = protected
    monkeypatch.setattr("mavfi.extras.hardening.plan.version", lambda package: "0.1")
    with pytest.raises(BadInputError, match="planned with numba .*, this is 0.1"):
        replay(directory, a_run(directory, "fi_safe").spec.run_id)


def test_hosts_that_are_not_deterministic_fly_nothing_again(tmp_path):
    run_campaign(small(host="tests.core.unit.campaign.fakes:WildHost", missions=1, faults=1, arms={}), tmp_path)
    with pytest.raises(BadInputError, match="host fake is not deterministic"):
        replay(tmp_path, "sparse-10000-golden")
