"""What MuJoCo takes from the C library, whose rounding differs between CPUs, changes no bit of a flight."""

import mujoco
import numpy as np
import pytest

import mavfi
from mavfi.sim import engine
from mavfi.sim.scene import STEP_US
from tests.core.golden import libm
from tests.core.unit.sim.flights import fly, open_world, simulator
from tests.night import at_night

_REASON = libm.why_not()
pytestmark = pytest.mark.skipif(bool(_REASON), reason=_REASON)
SECONDS = 4.5
BOX = {"lower": [(2.0, -2.0, 0.0)], "upper": [(4.0, 2.0, 9.0)]}
FLIGHTS = {
    "success": {"environment": "sparse", "seed": 7, "goal": (9.0, 0.0, 3.0), "start": (2.0, 0.0, 3.0), "wind": 2.0},
    "collision": {"environment": "dense", "seed": 6, "fault": "state:planning.trajectory.y:bit=62", "fault_seed": 6},
}


def inexact():
    assert engine.mj_step is not None  # the library is loaded
    return sorted(set(libm.imported(libm.loaded()[0])) - libm.EXACT)


def against_a_box():
    """Bytes of a flight that runs into a box, is pushed on and turned, and leaves it."""
    flight = simulator(open_world(5.0, **BOX))
    commands = (3.0, 0.3, 0.2, 1.0), (2.0, -1.0, 0.0, -2.0), (-3.0, 0.0, 0.5, 2.0)
    rows = [fly(flight, command, SECONDS / len(commands)) for command in commands]
    assert flight.collided
    return np.concatenate(rows).tobytes()


def raw_steps():
    """Attitudes of a turning body, stepped by MuJoCo alone."""
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    data.qvel[3:6] = 0.3, 0.5, 0.7
    rows = []
    for _ in range(50):
        mujoco.mj_step(model, data)
        rows.append(data.qpos[3:7].copy())
    return np.array(rows).tobytes()


def test_the_list_is_that_of_the_library():
    names = libm.imported(libm.loaded()[0])
    assert {"sin", "cos", "sqrt", "exp", "pow"} <= set(names)
    assert all(names.values())


def test_the_changes_reach_mujoco():
    before = raw_steps()
    for name in ("sin", "cos"):
        with libm.changed({name}) as calls:
            assert raw_steps() != before
        assert calls[name] == 50
    with libm.changed(set()) as calls:
        assert raw_steps() == before
    assert calls["sin"] == 50
    assert raw_steps() == before


def test_a_step_calls_sine_and_cosine_once_and_nothing_else():
    with libm.changed(set()) as calls:
        against_a_box()
    steps = round(1e6 * SECONDS / STEP_US)
    assert calls == {"sin": steps, "cos": steps}


@pytest.mark.parametrize("name", [*inexact()[:2], *at_night(*inexact()[2:])])
def test_a_unit_in_the_last_place_changes_no_flight_with_contacts(name):
    before = against_a_box()
    with libm.changed({name}):
        assert against_a_box() == before


@pytest.mark.slow
@pytest.mark.parametrize("flight", FLIGHTS)
def test_a_unit_in_the_last_place_of_all_changes_no_flight(flight):
    before = mavfi.fly(**FLIGHTS[flight])
    with libm.changed(set(inexact())) as calls:
        after = mavfi.fly(**FLIGHTS[flight])
    assert after.log.digest() == before.log.digest()
    assert set(calls) == {"sin", "cos"} and after.status.label == flight
