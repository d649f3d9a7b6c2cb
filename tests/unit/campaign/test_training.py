import pytest

from mavfi.campaign.config import TRAINING_SEED
from mavfi.campaign.recordings import FOLDER, KeptRecordings
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


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_only_successful_flights_are_kept_in_the_order_of_their_seeds(workers):
    told = []
    recordings = record_flights(SCENARIO, 6, workers, WATCHED, lambda kept, wanted: told.append((kept, wanted)))
    assert list(recordings) == [TRAINING_SEED + offset for offset in (1, 2, 3, 5, 6, 7)]
    assert (told[0], told[-1]) == ((0, 6), (6, 6))
    assert all(len(recording.times_us) for recording in recordings.values())


def _stop_at(wanted, told):
    def tell(kept, _):
        told.append(kept)
        if kept == wanted and len(told) > 1:
            raise KeyboardInterrupt

    return tell


def _content(recordings):
    return {seed: (r.kinds.tolist(), r.times_us.tolist(), r.content.tobytes()) for seed, r in recordings.items()}


@pytest.mark.slow
def test_what_is_flown_is_kept_when_training_is_stopped(tmp_path):
    disk, told = KeptRecordings(tmp_path, SCENARIO), []
    with pytest.raises(KeyboardInterrupt):
        record_flights(SCENARIO, 6, 1, WATCHED, _stop_at(4, told), disk)
    assert told == [0, 1, 2, 3, 4]
    told.clear()
    found = record_flights(SCENARIO, 6, 1, WATCHED, lambda kept, _: told.append(kept), disk)
    assert told[0] == 4
    assert _content(found) == _content(record_flights(SCENARIO, 6, 1, WATCHED))
    disk.delete()
    assert not list(tmp_path.iterdir())


def test_recordings_of_another_scenario_or_code_and_broken_ones_are_not_used(tmp_path, monkeypatch):
    disk = KeptRecordings(tmp_path, SCENARIO)
    record_flights(SCENARIO, 3, 1, WATCHED, disk=disk)
    seeds = [TRAINING_SEED + offset for offset in (1, 2, 3)]
    assert list(disk.load(seeds)) == seeds
    assert list(KeptRecordings(tmp_path, SCENARIO.model_copy(update={"seed": 7})).load(seeds)) == seeds
    assert KeptRecordings(tmp_path, SCENARIO.model_copy(update={"v_max": 2.0})).load(seeds) == {}
    (kept,) = (tmp_path / FOLDER).iterdir()
    (kept / f"{seeds[0]}.npz").write_bytes(b"PK")
    (kept / f"{seeds[1]}.npz").write_bytes((kept / f"{seeds[2]}.npz").read_bytes()[:100])
    assert list(disk.load(seeds)) == seeds[2:]
    monkeypatch.setattr("mavfi.campaign.recordings._code", lambda: "another")
    assert KeptRecordings(tmp_path, SCENARIO).load(seeds) == {}


def test_recordings_are_deleted_when_the_models_are_saved(tmp_path, monkeypatch):
    def save(model, folder):
        assert len(list(folder.glob(f"{FOLDER}/*/*.npz"))) == 3
        return [folder / "model.json"]

    monkeypatch.setattr("mavfi.detectors.training.fit", lambda recordings, provenance: len(recordings))
    monkeypatch.setattr("mavfi.detectors.training.save", save)
    assert train(tmp_path, 3, workers=1, tools=WATCHED) == [tmp_path / "model.json"]
    assert not (tmp_path / FOLDER).exists()


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
