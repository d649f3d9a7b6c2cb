import pickle

import numpy as np
import pytest

from mavfi.campaign.training import fit
from mavfi.detectors import load_detector
from mavfi.detectors.scoring import NOT_FINITE
from mavfi.errors import BadInputError
from mavfi.extras.bench.field_codes import ALL_FIELDS, CodeRecorder, FieldCodes
from mavfi.flight.fly import fly as fly_mission
from mavfi.mission import MissionStatus
from mavfi.states import AUTOPILOTS, STATES, new_state
from tests.core.flights.missions import golden, mission
from tests.core.unit.detectors import streams
from tests.core.unit.detectors.streams import PROVENANCE, fly, later, odometry, strike
from tests.core.unit.detectors.test_registry import FITS

NAMES = ("limits", "autoencoder_all")
GROSS = [
    ("perception.collision_status", 40, "future_collision_seq", 4096),
    ("perception.collision_status", 40, "collision", True),
    ("planning.waypoint", 20, "x", -1e30),
    ("planning.waypoint", 20, "index", 9999),
    ("planning.waypoint", 20, "duration", 1e6),
    ("planning.waypoint", 20, "vy", 1e307),  # finite, and too large for a number of quanta
    ("control.command", 333, "vy", 1e20),
    ("control.command", 333, "duration", -40.0),
]


def flight(seed, ticks=1500):
    """A stream in which the flag says what the counter does."""
    events = streams.flight(seed, ticks)
    for state, _ in events:
        if state.spec.name == "perception.collision_status":
            state.header["collision"] = state.header["time_to_collision"] < 30.0
    return events


def with_codes(events):
    recorder = CodeRecorder("published")
    for state, time_us in events:
        assert recorder.check(state, time_us) is None
        recorder.accept(state, time_us)
    return recorder.recording()


@pytest.fixture(scope="module")
def recordings():
    return [with_codes(flight(seed)) for seed in range(16)]


@pytest.fixture(scope="module")
def folder(recordings, tmp_path_factory):
    models = fit(ALL_FIELDS, recordings, PROVENANCE)
    assert set(models) == {f"{name}-tuned" for name in NAMES}
    place = tmp_path_factory.mktemp("models")
    for model in models.values():
        model.save(place)
    return place


def load(name, folder):
    return load_detector(name, "paper", folder, FITS)[0]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("state", "count", "field", "value"), GROSS)
def test_a_gross_fault_is_an_alarm_about_its_state(folder, name, state, count, field, value):
    events = flight(400)
    struck = later(events, state, count)
    alarms = dict(fly(load(name, folder), strike(events, struck, field, value)))
    alarm = alarms[struck]
    assert (alarm.source, alarm.stage, alarm.hard) == (name, STATES[state].stage, False)
    assert alarm.score > 1.0 and alarm.fields[0].startswith(state)


@pytest.mark.parametrize("name", NAMES)
def test_a_number_that_is_not_finite_is_an_alarm_and_leaves_the_rest_as_it_was(folder, name):
    events = flight(400)
    struck = later(events, "planning.waypoint", 20)
    found = dict(fly(load(name, folder), strike(events, struck, "vx", np.nan)))[struck]
    assert found.score == NOT_FINITE and found.fields[0].startswith("planning.waypoint")
    assert set(found.fields) <= {f"planning.waypoint.{field}" for field in ("x", "vx")}


@pytest.mark.parametrize("name", NAMES)
def test_no_training_flight_raises_an_alarm(folder, name):
    for seed in (0, 7):
        assert fly(load(name, folder), flight(seed)) == []


def struck_in_many_places():
    events = flight(6)
    for place, (state, _, field, value) in enumerate(GROSS):
        events = strike(events, later(events, state, 30 + place), field, value)
    return events


def finish(detector, events):
    """Alarms of the rest of a flight, and the memory at its end."""
    found = []
    for state, time_us in events:
        found.append(detector.check(state, time_us))
        detector.accept(state, time_us)
    return found, detector.memory()


@pytest.mark.parametrize("name", NAMES)
def test_a_copy_made_in_flight_does_as_the_detector_and_shares_no_memory_with_it(folder, name):
    detector, events = load(name, folder), struck_in_many_places()
    detector.start()
    finish(detector, events[:300])
    detector.check(*events[300])  # judged, not yet accepted
    other = pickle.loads(pickle.dumps(detector))
    assert finish(other, events[300:]) == finish(detector, events[300:])
    assert any(finish(load(name, folder), events)[0])


@pytest.mark.parametrize("name", NAMES)
def test_a_detector_with_replaced_functions_does_as_the_compiled_one(folder, name):
    plain, replaced, events = load(name, folder), load(name, folder), struck_in_many_places()
    called = dict.fromkeys(replaced.compiled, 0)

    def counting(own):
        def function(*arguments):
            called[own] += 1
            return replaced.compiled[own](*arguments)

        return function

    replaced.instrument({own: counting(own) for own in called})
    for detector in (plain, replaced):
        detector.start()
    assert finish(replaced, events) == finish(plain, events)
    silent = {own for own, count in called.items() if count == 0}
    assert silent == {"measure_path", "measure_trajectory", "measure_tracking"}, "the stream has no such publication"
    before = dict(called)
    replaced.instrument({})
    replaced.start()
    finish(replaced, events)
    assert called == before


@pytest.mark.parametrize("name", NAMES)
def test_a_detector_continues_from_what_it_remembered(folder, name):
    detector, other = load(name, folder), load(name, folder)
    events = flight(5, ticks=400)
    events = strike(events, later(events, "control.command", 300), "vx", 1e3)
    detector.start()
    for event in events[:400]:
        detector.check(*event), detector.accept(*event)
    memory = detector.memory()
    later_on = [(detector.check(*event), detector.accept(*event)) for event in events[400:]]
    assert detector.memory() != memory and any(alarm for alarm, _ in later_on)
    other.restore(memory)
    assert other.memory() == memory
    assert [(other.check(*event), other.accept(*event)) for event in events[400:]] == later_on


@pytest.mark.parametrize("name", NAMES)
def test_judging_changes_nothing_and_gives_the_score(folder, name):
    detector = load(name, folder)
    detector.start()
    for state, time_us in flight(6, ticks=200):
        memory = detector.memory()
        score, alarm = detector.score(state, time_us), detector.check(state, time_us)
        assert (alarm is not None) == (score is not None and score > 1.0)
        assert detector.memory() == memory and (score is None) == (state.spec.name == "sensor.odometry")
        detector.accept(state, time_us)


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_every_field_that_is_read_is_watched_and_no_other(autopilot):
    field_codes = FieldCodes(autopilot)
    watched = {name for name, quantum in zip(field_codes.fields, field_codes.quanta, strict=True) if quantum > 0.0}
    for state in field_codes.slots:
        for field in STATES[state].header:
            assert (f"{state}.{field.name}" in watched) == (not field.dead_in(autopilot)), field
    assert {f"planning.path.{name}" for name in ("start", "end", "detour")} <= watched


@pytest.mark.parametrize(("name", "count"), [("planning.path", 4), ("planning.trajectory", 8)])
@pytest.mark.parametrize("field", ["x", "y", "z"])
def test_a_point_out_of_place_moves_a_residual(name, count, field):
    field_codes = FieldCodes("published")
    codes, struck = (np.zeros(len(field_codes.fields), np.int16) for _ in range(2))
    state = new_state(name, count)
    state.elements["x"] = np.arange(count)
    slot = field_codes.slots[name]
    field_codes.note(odometry([0, 0, 0], [0, 0, 0]))
    for _ in range(2):
        assert field_codes.measure(state, slot, codes, keep=True) >= 0
    for element in range(count):
        wrong = state.copy()
        wrong.elements[field][element] = -300.0
        field_codes.measure(wrong, slot, struck)
        assert np.abs(struck.astype(int) - codes).max() > 1000
        wrong.elements[field][element] = np.nan
        assert field_codes.measure(wrong, slot, struck) < 0
        assert all(field_codes.fields[index].startswith(name) for index in field_codes.not_finite(wrong))


def test_recordings_that_cannot_serve_are_refused(recordings):
    wrong = strike(flight(0), 700, flight(0)[700][0].spec.header[0].name, np.inf)
    with pytest.raises(BadInputError, match="not finite"):
        fit(ALL_FIELDS, [with_codes(wrong)], PROVENANCE)
    good = recordings[0]
    assert ALL_FIELDS.is_whole(good)
    assert not ALL_FIELDS.is_whole(good._replace(codes=good.codes[:-1]))
    assert not ALL_FIELDS.is_whole(good._replace(slots=good.slots + np.int8(6)))
    assert not ALL_FIELDS.is_whole(good._replace(regimes=good.regimes[:-1]))


# ---- shipped models -------------------------------------------------------------------------------------------------
@pytest.mark.slow
@pytest.mark.parametrize("autopilot", AUTOPILOTS)
@pytest.mark.parametrize("name", NAMES)
def test_the_shipped_models_hardly_raise_an_alarm_on_a_golden_flight(name, autopilot):
    detector, _ = load_detector(name, "paper", None, {**FITS, "stack": autopilot})
    log = fly_mission(mission(autopilot), detector=detector).log
    assert len(log.alarms) <= 1 and log.status is MissionStatus.SUCCESS
    assert log.alarms or log.digest() == golden(autopilot).log.digest()
