import pickle

import numpy as np

from mavfi.detectors import features
from mavfi.detectors.training import WATCHED
from mavfi.states import new_state
from tests.core.unit.detectors.streams import command, flight, odometry, record, waypoint


def test_headers_come_back_as_they_were_published():
    events = flight(1)
    recording = record(events)
    for name in WATCHED:
        published = [(state.header, time_us) for state, time_us in events if state.spec.name == name]
        times_us, headers = recording.headers(name)
        assert times_us.tolist() == [time_us for _, time_us in published]
        assert headers.tobytes() == np.concatenate([header for header, _ in published]).tobytes()


def test_the_vehicle_is_kept_at_new_trajectories_only():
    where = [odometry([float(step), 0, 0], [0, 0, 0]) for step in range(3)]
    events = [where[0], waypoint([0, 0, 0], [0, 0, 0], trajectory=1), where[1], waypoint([1, 0, 0], [0, 0, 0])]
    events += [where[2], waypoint([2, 0, 0], [0, 0, 0], trajectory=2), command([0, 0, 0]), new_state("planning.path")]
    recording = record([(state, 20_000 * number) for number, state in enumerate(events)])
    way, ctl = WATCHED.index("planning.waypoint"), WATCHED.index("control.command")
    assert recording.kinds.tolist() == [features.ODOMETRY, way, way, features.ODOMETRY, way, ctl]
    assert features.real_at(recording.content, int(recording.ends[2])) == 2.0


def test_a_recording_is_small_and_travels():
    recording = record(flight(1))
    copy = pickle.loads(pickle.dumps(recording))
    assert copy.content.tobytes() == recording.content.tobytes()
    assert len(pickle.dumps(recording)) < 100_000
