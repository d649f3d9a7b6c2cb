"""World and airframe as a MuJoCo model."""

import mujoco
import numpy as np

from mavfi.config import VehicleConfig
from mavfi.sim import mjcf
from mavfi.sim.engine import GRAVITY
from mavfi.sim.environments.world import World

STEP_US = 4_000
"""Period of physics and of our flight controller (us); other controllers divide it."""

ACCELEROMETER, GYRO, CONTACTS = slice(0, 3), slice(3, 6), 6
"""Sensor addresses in MjData.sensordata."""
_SPHERE = "collision_sphere"


def build_model(world: World, vehicle: VehicleConfig, period_us: int = STEP_US) -> mujoco.MjModel:
    """The model of one flight: a free body with a sphere for contacts, static boxes, the ground.

    All forces except gravity and contact are external, in `qfrc_applied`.  They are constant during a step; therefore
    semi-implicit Euler is as accurate as `implicitfast` here and 0.3 us cheaper.  Voxel worlds have their own contact
    test; their model contains the body only.  A vehicle with an MJCF file has that model attached to its body.

    Args:
        world: Obstacles and start.
        vehicle: Airframe.
        period_us: Of the physics.
    """
    spec = mujoco.MjSpec()
    spec.option.timestep = period_us * 1e-6
    spec.option.gravity = np.array([0.0, 0.0, -GRAVITY])
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    if not world.is_voxels:
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=np.array([0.0, 0.0, 1.0]))
        for centre, half in zip(0.5 * (world.lower + world.upper), 0.5 * (world.upper - world.lower), strict=True):
            spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, pos=centre, size=half)
    body = spec.worldbody.add_body(pos=world.start)
    body.add_freejoint()
    size = np.array([vehicle.collision_radius, 0.0, 0.0])
    sphere = body.add_geom(name=_SPHERE, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=size)
    if vehicle.mjcf is None:
        body.mass, body.inertia, body.ipos = vehicle.mass, np.array(vehicle.inertia), np.zeros(3)
        body.explicitinertial = True
    else:
        sphere.mass = 0.0
        mjcf.attach(vehicle, spec, body)
    body.add_site(name="imu")
    _add_sensors(spec)
    return spec.compile()


def _add_sensors(spec: mujoco.MjSpec) -> None:
    site = mujoco.mjtObj.mjOBJ_SITE
    spec.add_sensor(type=mujoco.mjtSensor.mjSENS_ACCELEROMETER, objtype=site, objname="imu")
    spec.add_sensor(type=mujoco.mjtSensor.mjSENS_GYRO, objtype=site, objname="imu")
    count_contacts = 1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND)
    spec.add_sensor(
        type=mujoco.mjtSensor.mjSENS_CONTACT,
        objtype=mujoco.mjtObj.mjOBJ_GEOM,
        objname=_SPHERE,
        intprm=[count_contacts, 0, 1],
    )
