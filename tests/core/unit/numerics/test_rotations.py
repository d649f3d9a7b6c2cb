"""Rotations against SciPy."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavfi.numerics.rotations import rotation_matrix, wrap_angle, yaw_of


@pytest.mark.parametrize("rotation", list(Rotation.random(20, random_state=1)))
def test_matrix_and_yaw_equal_those_of_scipy(rotation):
    quaternion = np.roll(rotation.as_quat(), 1)
    matrix = np.empty((3, 3))
    rotation_matrix(quaternion, matrix)
    np.testing.assert_allclose(matrix, rotation.as_matrix(), atol=1e-14)
    assert yaw_of(quaternion) == pytest.approx(math.atan2(matrix[1, 0], matrix[0, 0]), abs=1e-12)


@pytest.mark.parametrize(
    ("angle", "expected"),
    (
        (0.0, 0.0),
        (math.pi, -math.pi),
        (-math.pi, -math.pi),
        (3.5 * math.pi, -0.5 * math.pi),
        (-7.0, 2.0 * math.pi - 7.0),
    ),
)
def test_wrapped_angles_are_the_same_directions(angle, expected):
    assert wrap_angle(angle) == pytest.approx(expected)


@pytest.mark.parametrize("angle", (math.nan, math.inf, -math.inf))
def test_what_is_no_angle_stays_none(angle):
    assert math.isnan(wrap_angle(angle))
