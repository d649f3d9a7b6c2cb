import numpy as np
import pytest

from mavfi.campaign import training
from mavfi.campaign.config import TRAINING_SEED
from mavfi.campaign.training import (
    FOLDER,
    KeptRecordings,
    record_flights,
    training_mission,
    trainings_of,
)
from mavfi.detectors.training import MONITORED_FIELDS
from mavfi.errors import BadInputError
from mavfi.flight.host import Flight
from mavfi.mission import MissionSpec, MissionStatus
from mavfi.record import COLUMNS, FlightLog
from tests.core.unit.detectors.streams import command, status, waypoint

SCENARIO = training_mission(MissionSpec())


def fly(scenario, *, recorders):
    """Every fourth mission fails; what is published is seen by the recorders."""
    for number in range(8):
        for state in (status(30.0, scenario.seed % 100), waypoint([number, 0, 0], [1, 0, 0]), command([1, 0, 0])):
            for accept in recorders:
                accept(state, 20_000 * number)
    end = MissionStatus.TIMEOUT if scenario.seed % 4 == 0 else MissionStatus.SUCCESS
    return Flight(FlightLog(np.zeros((1, len(COLUMNS))), end, [], [], [], {}))


@pytest.fixture(autouse=True)
def _no_simulator(monkeypatch):
    monkeypatch.setattr(training, "fly", fly)


@pytest.mark.parametrize("workers", [1, 2])
def test_only_successful_flights_are_kept_in_the_order_of_their_seeds(workers):
    shown = []
    recordings = record_flights(SCENARIO, 6, workers, lambda kept, wanted: shown.append((kept, wanted)))
    assert list(recordings) == [TRAINING_SEED + offset for offset in (1, 2, 3, 5, 6, 7)]
    assert (shown[0], shown[-1]) == ((0, 6), (6, 6))
    assert all(len(recording.times_us) for (recording,) in recordings.values())


def test_training_flies_its_own_worlds_as_the_mission_asks_for():
    mission = MissionSpec(environment="dense", seed=3, goal=(1.0, 2.0, 3.0), autopilot="hardened", v_max=2.0)
    scenario = training_mission(mission)
    assert (scenario.environment.name, scenario.seed, scenario.goal) == ("training", TRAINING_SEED, None)
    assert (scenario.autopilot.name, scenario.v_max) == ("hardened", 2.0)


def _stop_at(wanted, shown):
    def tell(count, _):
        shown.append(count)
        if count == wanted and len(shown) > 1:
            raise KeyboardInterrupt

    return tell


def _content(recordings):
    return {seed: (r.kinds.tolist(), r.times_us.tolist(), r.content.tobytes()) for seed, (r,) in recordings.items()}


def test_what_is_flown_is_kept_when_training_is_stopped(tmp_path):
    disk, shown = KeptRecordings(tmp_path, SCENARIO), []
    with pytest.raises(KeyboardInterrupt):
        record_flights(SCENARIO, 6, 1, _stop_at(4, shown), disk)
    assert shown == [0, 1, 2, 3, 4]
    shown.clear()
    recorded = record_flights(SCENARIO, 6, 1, lambda count, _: shown.append(count), disk)
    assert shown[0] == 4
    assert _content(recorded) == _content(record_flights(SCENARIO, 6, 1))
    disk.delete()
    assert not list(tmp_path.iterdir())


def test_recordings_of_another_scenario_or_code_and_broken_ones_are_not_used(tmp_path, monkeypatch):
    disk = KeptRecordings(tmp_path, SCENARIO)
    record_flights(SCENARIO, 3, 1, disk=disk)
    seeds = [TRAINING_SEED + offset for offset in (1, 2, 3)]
    assert list(disk.load(seeds)) == seeds
    assert list(KeptRecordings(tmp_path, SCENARIO.model_copy(update={"seed": 7})).load(seeds)) == seeds
    assert KeptRecordings(tmp_path, SCENARIO.model_copy(update={"v_max": 2.0})).load(seeds) == {}
    (stored_file,) = (tmp_path / FOLDER).iterdir()
    (stored_file / f"{seeds[0]}.npz").write_bytes(b"PK")
    (stored_file / f"{seeds[1]}.npz").write_bytes((stored_file / f"{seeds[2]}.npz").read_bytes()[:100])
    assert list(disk.load(seeds)) == seeds[2:]
    monkeypatch.setattr("mavfi.campaign.training.code", lambda: "another")
    assert KeptRecordings(tmp_path, SCENARIO).load(seeds) == {}


def _never_arrives(task):
    return None


def test_too_few_successes_are_an_error(monkeypatch):
    monkeypatch.setattr(training, "record_flight", _never_arrives)
    with pytest.raises(BadInputError, match="only 0 of 6 missions reached their goals; 2 wanted"):
        record_flights(SCENARIO, 2, 1)
    with pytest.raises(BadInputError, match="flights: 0"):
        record_flights(SCENARIO, 0, 1)


def test_only_what_is_needed_is_recorded(tmp_path):
    (wanted,) = trainings = trainings_of(only=[("gaussian", "paper")])
    assert wanted is MONITORED_FIELDS
    disk = KeptRecordings(tmp_path, SCENARIO, trainings)
    ((seed, recorded),) = record_flights(SCENARIO, 1, 1, disk=disk, trainings=trainings).items()
    assert len(recorded) == 1 and len(recorded[0].content)
    assert list(disk.load([seed])) == [seed]
    assert KeptRecordings(tmp_path, SCENARIO, trainings_of()).load([seed]) == {}, "other recordings than for all"
