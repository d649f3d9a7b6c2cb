import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavfi.errors import BadInputError
from mavfi.extras.bench.sealed import ALL, SMALL, Checksum, Duplicate, Oracle, RandomAlarms
from mavfi.states import STATES, new_state
from tests.core.unit.detectors.streams import flight

CLOUD = "perception.point_cloud"
BOTH = [lambda: Checksum(large=True), Oracle]


def struck(state, bit):
    """One bit flipped somewhere in header or elements."""
    changed = state.copy()
    header, elements = changed.header.view(np.uint8), changed.elements.view(np.uint8) if len(changed.elements) else None
    byte, bit_of_byte = bit // 8 % (len(header) + (0 if elements is None else len(elements))), bit % 8
    content, byte = (header, byte) if byte < len(header) else (elements, byte - len(header))
    content[byte] ^= np.uint8(1 << bit_of_byte)
    return changed


@pytest.mark.parametrize("make", BOTH)
@given(name=st.sampled_from(sorted(ALL)), count=st.integers(0, 3), bit=st.integers(0, 5000))
def test_any_bit_that_is_changed_on_the_way_is_an_alarm_and_nothing_else_is(make, name, count, bit):
    detector = make()
    state = new_state(name, count if STATES[name].elements else 0)
    detector.seal(state, 0)
    for same in (state, state.copy()):
        assert detector.check(same, 0) is None and detector.score(same, 0) == 0.0
    alarm = detector.check(struck(state, bit), 0)
    assert (alarm.source, alarm.stage, alarm.hard) == (detector.source, STATES[name].stage, True)
    assert alarm.score > 1.0 and alarm.fields == (name,)


def test_clouds_and_map_updates_are_sealed_by_choice():
    assert {CLOUD, "perception.map_update"} == ALL - SMALL
    cloud = new_state(CLOUD, 2)
    for detector, seen in ((Checksum(), False), (Checksum(large=True), True)):
        detector.seal(cloud, 0)
        assert (detector.check(struck(cloud, 400), 0) is not None) == seen


def alarms(detector, events):
    raised = []
    for state, time_us in events:
        score, alarm = detector.score(state, time_us), detector.check(state, time_us)
        assert (alarm is not None) == (score is not None and score > 1.0)
        raised += [(time_us, state.spec.name)] if alarm else []
        detector.accept(state, time_us)
    return raised


def test_random_alarms_have_their_rate_and_depend_on_the_mission_alone():
    events = flight(3, ticks=3000)
    hours = events[-1][1] / 3.6e9
    first, again, other = (RandomAlarms(seed, per_hour=20_000.0) for seed in (5, 5, 6))
    # two of the six small states with alarms are rare here, and three are absent
    raised = alarms(first, events)
    expected = hours * 20_000 / 6 * 2
    assert 0.5 * expected < len(raised) < 1.5 * expected
    assert alarms(again, events) == raised != alarms(other, events)
    first.start()
    assert alarms(first, events) == raised


def test_figures_that_are_no_rate_and_kernels_that_are_none_are_refused():
    with pytest.raises(BadInputError, match="per_hour: 0.0; allowed: above 0"):
        RandomAlarms(1, per_hour=0.0)
    with pytest.raises(BadInputError, match="kernels: tracker: not known; allowed: state_estimation"):
        Duplicate(["pid", "tracker"])
