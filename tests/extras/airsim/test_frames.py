"""AirSim's frames and objects."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavfi.errors import BadInputError
from mavfi.extras.airsim import frames
from mavfi.numerics.rotations import rotation_matrix

NUMBERS = st.floats(allow_nan=False, allow_infinity=False)


@given(st.tuples(NUMBERS, NUMBERS, NUMBERS))
def test_a_vector_comes_back_bit_for_bit(values):
    assert frames.flipped(frames.flipped(values)) == values
    assert frames.from_vector3r(frames.to_vector3r(values)) == values


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 4), st.tuples(*[st.floats(-10.0, 10.0)] * 3))
def test_turning_in_either_frame_is_the_same(quaternion, values):
    norm = float(np.linalg.norm(quaternion))
    if norm < 1e-3:
        return
    ours, theirs = np.empty((3, 3)), np.empty((3, 3))
    unit = np.array(quaternion) / norm
    rotation_matrix(unit, ours)
    rotation_matrix(np.array(frames.turned(unit)), theirs)
    np.testing.assert_allclose(frames.flipped(ours @ values), theirs @ frames.flipped(values), atol=1e-9)


@pytest.mark.parametrize(
    ("read", "name"),
    [
        (frames.from_vector3r, "Vector3r"),
        (frames.from_quaternionr, "Quaternionr"),
        (frames.from_pose, "Pose"),
        (frames.from_geo_point, "GeoPoint"),
    ],
)
@pytest.mark.parametrize("data", [None, 3.0, {}, {"x_val": "a"}, []])
def test_another_object_is_refused_by_name(read, name, data):
    with pytest.raises(BadInputError, match=f"allowed: a {name}"):
        read(data)
