import mujoco

from mavfi.sim import engine  # noqa: F401 - replaces the clock


def test_timers_of_mujoco_stand_still():
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    for _ in range(1000):
        mujoco.mj_step(model, data)
    step = data.timer[mujoco.mjtTimer.mjTIMER_STEP]
    assert step.number == 1000 and step.duration == 0.0
