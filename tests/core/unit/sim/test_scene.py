"""The MuJoCo model of a flight."""

import mujoco
import numpy as np

from mavfi.sim.environments.generated import cuboids
from mavfi.sim.scene import build_model
from tests.core.unit.sim.flights import scenario


def test_the_model_carries_the_airframe_and_the_boxes():
    world = cuboids(1, 0.05, 6.0)
    model = build_model(world, scenario().vehicle)
    assert model.nv == 6 and model.ngeom == len(world.lower) + 2 and model.nsensordata == 7
    assert model.body_mass[1] == 1.0 and model.opt.timestep == 0.004
    np.testing.assert_array_equal(model.body_inertia[1], scenario().vehicle.inertia)
    np.testing.assert_allclose(model.geom_pos[1:-1] - model.geom_size[1:-1], world.lower, atol=1e-12)
    assert model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
