import pytest

from mavfi.campaign.replay import replay
from mavfi.campaign.run import run_campaign
from mavfi.campaign.store import Store
from mavfi.campaign.worker import Tools
from mavfi.errors import BadInputError, SpecMismatchError
from tests.unit.campaign import fakes
from tests.unit.campaign.fakes import FAKE, small


@pytest.fixture(scope="module")
def directory(tmp_path_factory):
    directory = tmp_path_factory.mktemp("campaign")
    run_campaign(small(environments=["dense"]), directory, workers=1, tools=FAKE)
    return directory


def a_run(directory, setting):
    with Store.open(directory) as store:
        return next(run for run in store.runs() if run.spec.setting == setting)


@pytest.mark.parametrize("setting", ["golden", "fi", "dr_gaussian", "null"])
def test_the_same_flight_comes_out(directory, setting):
    run = a_run(directory, setting)
    again = replay(directory, run.spec.run_id, FAKE)
    assert again.same
    assert again.run == run
    assert again.flight.log.status.label == run.record["status"]


def test_the_twin_has_the_same_mission_and_detector(directory):
    again = replay(directory, a_run(directory, "dr_gaussian").spec.run_id, FAKE)
    assert again.twin.spec.setting == "golden_gaussian"
    assert again.twin.spec.seed == again.run.spec.seed
    assert replay(directory, a_run(directory, "golden").spec.run_id, FAKE).twin is None


def slower(scenario, fault, detector, *, want_profile):
    flight = fakes.fly(scenario, fault, detector, want_profile=want_profile)
    flight.log.rows[3, 1] += 1e-9
    return flight


def other_model(detector, profile, models_dir, scenario):
    return fakes.FakeDetector(), "trained since"


def test_another_flight_is_told(directory):
    again = replay(directory, a_run(directory, "fi").spec.run_id, Tools(slower, FAKE.load_detector, FAKE.make_scenario))
    assert not again.same


def test_another_model_is_refused(directory):
    with pytest.raises(SpecMismatchError, match="planned with the model 0123456789ab"):
        replay(
            directory, a_run(directory, "dr_gaussian").spec.run_id, Tools(fakes.fly, other_model, FAKE.make_scenario)
        )


def test_what_is_not_there_is_bad_input(directory, tmp_path):
    with pytest.raises(BadInputError, match="holds no campaign"):
        replay(tmp_path, "x", FAKE)
    with pytest.raises(BadInputError, match="no run of that name"):
        replay(directory, "sparse-1", FAKE)
