"""A plain twin of what the acceptance test remembers: tuples and dictionaries, replaced at each publication."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavfi.detectors import acceptance
from mavfi.states import new_state
from tests.core.unit.detectors.streams import LIMITS

BEGAN_US = int(0.7 * 1e6 * LIMITS["published"].planner_latency)


class Twin:
    def __init__(self):
        self.counters = ((-(1 << 62), 0),)
        self.trajectories = {}

    def note_status(self, counter, now):
        if counter != self.counters[-1][1]:
            self.counters = (*self.counters[1 - acceptance.KEPT_COUNTERS :], (now, counter))

    def answerable(self, now):
        began = now - BEGAN_US
        before = [value for time, value in self.counters if time <= began][-1:]
        return before + [value for time, value in self.counters if time > began - 300_000]

    def note_trajectory(self, number, points):
        if len(points):
            newest = [item for item in self.trajectories.items() if item[0] != number][1 - acceptance.KEPT :]
            self.trajectories = dict([*newest, (number, points)])


@pytest.fixture(scope="module")
def record():
    return acceptance.new_record(LIMITS["published"])


@settings(max_examples=200)
@given(st.lists(st.tuples(st.integers(1, 200_000), st.integers(-(2**31), 2**31 - 1) | st.integers(0, 3)), max_size=12))
def test_counters_that_a_path_can_answer(record, notes):
    twin, now, state = Twin(), 0, new_state("perception.collision_status")
    acceptance.forget(record)
    for step, counter in notes:
        now += step
        state.header["future_collision_seq"] = counter
        acceptance.note_status(state.header, now, record)
        twin.note_status(counter, now)
        for later in (now, now + BEGAN_US, now + 400_000):
            assert acceptance.answerable(later, record).tolist() == twin.answerable(later)


@settings(max_examples=200)
@given(st.lists(st.tuples(st.integers(1, 6), st.integers(0, 5)), max_size=12))
def test_points_of_the_last_trajectories(record, notes):
    twin, state, blocks = Twin(), new_state("planning.trajectory"), np.zeros((acceptance.KEPT, 5, 11))
    acceptance.forget(record)
    for number_of_note, (number, count) in enumerate(notes):
        points = np.full((count, 11), float(number_of_note))
        state.header["trajectory_seq"] = number
        acceptance.note_trajectory(state.header, points, record, blocks)
        twin.note_trajectory(number, points)
        for wanted in range(8):
            expected = twin.trajectories.get(wanted, np.zeros((0, 11)))
            assert np.array_equal(acceptance.points_of(wanted, record, blocks), expected)
        last = next(reversed(twin.trajectories.values()), np.zeros((0, 11)))
        assert np.array_equal(acceptance.newest(record, blocks), last)
