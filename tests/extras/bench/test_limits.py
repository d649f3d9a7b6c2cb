import numpy as np
import pytest

from mavfi.campaign.training import fit
from mavfi.detectors.registry import load_detector
from mavfi.detectors.scoring import NOT_FINITE
from mavfi.extras.bench.field_codes import ALL_FIELDS, CodeRecorder, FieldCodes
from mavfi.states import AUTOPILOTS, STATES
from mavfi.testing import DetectorContract
from tests.core.unit.detectors import streams
from tests.core.unit.detectors.streams import PROVENANCE, fly, later, strike
from tests.core.unit.detectors.test_registry import FITS

NAME = "limits"
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
    assert set(models) == {"limits-tuned"}
    models_dir = tmp_path_factory.mktemp("models")
    models["limits-tuned"].save(models_dir)
    return models_dir


def load(folder):
    return load_detector(NAME, "paper", folder, FITS)[0]


@pytest.mark.parametrize(("state", "count", "field", "value"), GROSS)
def test_a_gross_fault_is_an_alarm_about_its_state(folder, state, count, field, value):
    events = flight(400)
    struck = later(events, state, count)
    alarms = dict(fly(load(folder), strike(events, struck, field, value)))
    alarm = alarms[struck]
    assert (alarm.source, alarm.stage, alarm.hard) == (NAME, STATES[state].stage, False)
    assert alarm.score > 1.0 and alarm.fields[0].startswith(state)


def test_a_number_that_is_not_finite_is_an_alarm_and_leaves_the_rest_as_it_was(folder):
    events = flight(400)
    struck = later(events, "planning.waypoint", 20)
    alarm = dict(fly(load(folder), strike(events, struck, "vx", np.nan)))[struck]
    assert alarm.score == NOT_FINITE and alarm.fields[0].startswith("planning.waypoint")
    assert set(alarm.fields) <= {f"planning.waypoint.{field}" for field in ("x", "vx")}


def struck_in_many_places():
    events = flight(6)
    for index, (state, _, field, value) in enumerate(GROSS):
        events = strike(events, later(events, state, 30 + index), field, value)
    return events


def finish(detector, events):
    """Alarms of the rest of a flight, and the memory at its end."""
    alarms = []
    for state, time_us in events:
        alarms.append(detector.check(state, time_us))
        detector.accept(state, time_us)
    return alarms, detector.memory()


def test_a_detector_with_replaced_functions_does_as_the_compiled_one(folder):
    plain, replaced, events = load(folder), load(folder), struck_in_many_places()
    called = dict.fromkeys(replaced.compiled, 0)

    def counting(plain_function):
        def function(*arguments):
            called[plain_function] += 1
            return replaced.compiled[plain_function](*arguments)

        return function

    replaced.instrument({plain_function: counting(plain_function) for plain_function in called})
    for detector in (plain, replaced):
        detector.start()
    assert finish(replaced, events) == finish(plain, events)
    silent = {plain_function for plain_function, count in called.items() if count == 0}
    assert silent == {"measure_path", "measure_trajectory", "measure_tracking"}, "the stream has no such publication"
    before = dict(called)
    replaced.instrument({})
    replaced.start()
    finish(replaced, events)
    assert called == before


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_every_field_that_is_read_is_watched_and_no_other(autopilot):
    field_codes = FieldCodes(autopilot)
    watched = {name for name, quantum in zip(field_codes.fields, field_codes.quanta, strict=True) if quantum > 0.0}
    for state in field_codes.slots:
        for field in STATES[state].header:
            assert (f"{state}.{field.name}" in watched) == (not field.dead_in(autopilot)), field
    assert {f"planning.path.{name}" for name in ("start", "end", "detour")} <= watched


# ---- shipped model: memory, copies, scores, and golden flights -------------------------------------------------------
class TestLimits(DetectorContract):
    detector = NAME
