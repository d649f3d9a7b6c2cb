"""The flight controller, the rotors and the airframe."""

import numpy as np
import pytest

from mavfi.config import VehicleConfig, shipped
from mavfi.sim.cascade import mix_rotors
from mavfi.sim.vehicle import airframe_of, apply_forces
from tests.core.unit.sim.flights import fly, simulator


def airframe(name="airsim_quad", **changes):
    return airframe_of(shipped("vehicles", VehicleConfig, name).model_copy(update=changes))


def test_tilt_stays_within_its_limit():
    rows = fly(simulator(v_max=20.0), (20.0, 0.0, 0.0, 0.0), 1.0)
    cosine = 1.0 - 2.0 * (rows[:, 7] ** 2 + rows[:, 8] ** 2)
    assert np.degrees(np.arccos(cosine)).max() < 36.0


def test_the_mixer_gives_the_thrust_and_the_torque_asked_for():
    frame, wanted, forces = airframe(), np.empty(4), np.empty(6)
    torque = (0.05, -0.03, 0.01)
    mix_rotors(frame, 9.5, torque, wanted)
    apply_forces(frame, wanted, np.zeros(3), np.eye(3), forces)
    np.testing.assert_allclose(forces, (0.0, 0.0, 9.5, *torque), atol=1e-12)


@pytest.mark.parametrize("thrust", (-1e3, 0.0, 9.8, 1e300))
@pytest.mark.parametrize("torque", ((1e300, 0.0, 0.0), (-1e3, 1e3, 1e3), (0.0, 0.0, -1e300)))
def test_rotors_saturate_within_what_they_can_give(thrust, torque):
    frame, wanted = airframe(), np.empty(4)
    mix_rotors(frame, thrust, torque, wanted)
    assert (wanted >= 0.0).all() and (wanted <= frame.max_thrust).all()
