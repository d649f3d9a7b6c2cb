import pytest

from mavfi.campaign.config import TRAINING_SEED
from mavfi.campaign.training import record_flights, train
from mavfi.campaign.worker import Tools
from mavfi.errors import BadInputError
from mavfi.mission import MissionStatus
from tests.unit.campaign import fakes
from tests.unit.campaign.fakes import FAKE, publications

SCENARIO = FAKE.make_scenario(
    "training", TRAINING_SEED, stack="published", platform="i9-9940x", planner="rrt_connect", v_max=None
)


def fly_watched(scenario, fault, detector, *, want_profile):
    """Every fourth mission fails; what is published is seen by the detector."""
    assert fault is None
    flight = fakes.fly(scenario, None, None, want_profile=want_profile)
    detector.start()
    for state, time_us in publications():
        state.header[state.header.dtype.names[0]] = scenario.seed % 100
        assert detector.check(state, time_us) is None
        detector.accept(state, time_us)
    if scenario.seed % 4 == 0:
        flight.log.status = MissionStatus.TIMEOUT
    return flight


def never_arrives(scenario, fault, detector, *, want_profile):
    flight = fakes.fly(scenario, None, None, want_profile=want_profile)
    flight.log.status = MissionStatus.NO_PATH
    return flight


WATCHED = Tools(fly_watched, FAKE.load_detector, FAKE.make_scenario)


@pytest.mark.parametrize("workers", [1, 2])
def test_only_successful_flights_are_kept_in_the_order_of_their_seeds(workers):
    told = []
    recordings = record_flights(SCENARIO, 6, workers, WATCHED, lambda kept, wanted: told.append((kept, wanted)))
    assert list(recordings) == [TRAINING_SEED + offset for offset in (1, 2, 3, 5, 6, 7)]
    assert told[-1] == (6, 6)
    assert all(len(recording.times_us) for recording in recordings.values())


def test_too_few_successes_are_an_error():
    tools = Tools(never_arrives, FAKE.load_detector, FAKE.make_scenario)
    with pytest.raises(BadInputError, match="only 0 of 6 missions reached their goals; 2 wanted"):
        record_flights(SCENARIO, 2, 1, tools)
    with pytest.raises(BadInputError, match="flights: 0"):
        record_flights(SCENARIO, 0, 1, tools)


def test_a_folder_that_cannot_be_written_is_found_before_the_flights(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(BadInputError, match="cannot be written"):
        train(tmp_path / "file" / "models", 5, tools=WATCHED)
