"""A plain twin of the deltas: whole columns in NumPy, no memory, no bytes."""

import numpy as np
import pytest

from mavfi.detectors import training
from mavfi.detectors.preprocess import Preprocessor
from tests.core.unit.detectors.streams import flight, record


def code(values, threshold):
    """Sign times octaves above 2**threshold, by frexp instead of bit fields."""
    octaves = np.frexp(values)[1] - threshold
    return (np.sign(values) * np.maximum(0, np.where(values == 0.0, 0, octaves))).astype(int)


def column(recording, name, field):
    return recording.headers(name)[1][field].astype(np.float64)


@pytest.fixture(scope="module")
def recording():
    return record(flight(11))


def deltas(recording, profile, name):
    preprocessor = Preprocessor("paper-13", profile, "interval")
    sample = training.collect([recording], preprocessor)
    first, last = preprocessor.range_of(preprocessor.slots[name])
    return sample.vectors[(sample.slots == preprocessor.slots[name]) & ~sample.first, first:last]


THRESHOLDS = {"x": -1, "y": -1, "z": -1, "time_to_collision": 0}
FIELDS = {
    "perception.collision_status": ("time_to_collision",),
    "planning.waypoint": ("x", "y", "z", "yaw", "vx", "vy", "vz"),
    "control.command": ("vx", "vy", "vz", "yaw_rate"),
}


@pytest.mark.parametrize("name", FIELDS)
def test_paper_deltas(recording, name):
    measured = deltas(recording, "paper", name)
    for index, field in enumerate(FIELDS[name]):
        expected = np.diff(code(column(recording, name, field), THRESHOLDS.get(field, -2)))
        assert measured[:, index].tolist() == expected.tolist()


def test_tuned_deltas_of_commands(recording):
    measured = deltas(recording, "tuned", "control.command")
    for index, field in enumerate(FIELDS["control.command"]):
        expected = code(np.diff(column(recording, "control.command", field)), -3)
        assert measured[:, index].tolist() == expected.tolist()


def test_tuned_deltas_of_positions_are_innovations(recording):
    measured = deltas(recording, "tuned", "planning.waypoint")
    seq = column(recording, "planning.waypoint", "trajectory_seq")
    same = seq[1:] == seq[:-1]
    assert 0 < same.sum() < len(same)
    assert training.innovations(recording)["interval"].shape == (same.sum(), 3)
    expected = code(training.innovations(recording)["interval"], -3)
    assert measured[same, :3].tolist() == expected.tolist()
    assert np.abs(measured[same, :3]).max() == 0
