import numpy as np
import pytest

from mavfi.errors import BadInputError
from mavfi.states import (
    KERNELS,
    MONITORED_SETS,
    ODOMETRY,
    STATES,
    find_state,
    floats,
    new_state,
    rows,
    states_with,
    unknown,
)


@pytest.mark.parametrize("name", STATES)
def test_the_leading_floats_of_a_state_share_its_memory(name):
    state = new_state(name, 3 if STATES[name].elements else 0)
    for fields, array in ((state.spec.header, state.header), (state.spec.elements, state.elements)):
        count = next((i for i, field in enumerate(fields) if field.dtype != "f8"), len(fields))
        if count == 0 or len(array) == 0:
            continue
        plain = floats(array, count) if array is state.header else rows(array, count)[-1]
        assert np.shares_memory(plain, array)
        plain[:] = np.arange(1.0, count + 1.0)
        assert [array[field.name][-1] for field in fields] == [*range(1, count + 1), *[0] * (len(fields) - count)]


def test_a_copy_shares_nothing_and_has_the_same_bits():
    state = new_state("planning.trajectory", 2)
    state.elements["x"] = np.nan
    copy = state.copy()
    assert copy.same_bits(state)
    copy.elements["x"][1] = -0.0
    assert not copy.same_bits(state) and np.isnan(state.elements["x"]).all()
    zero, minus = new_state("control.command"), new_state("control.command")
    minus.header["vx"] = -0.0
    assert not zero.same_bits(minus)
    assert not new_state("planning.path", 1).same_bits(new_state("planning.path", 2))


def test_a_name_in_both_parts_means_the_element():
    spec = STATES["perception.point_cloud"]
    assert spec.find("x").dtype == "f4" and spec.in_elements("x")
    acceleration = STATES["planning.waypoint"].find("ax")
    assert acceleration.dead_in("published") and not acceleration.dead_in("hardened")
    assert not STATES["planning.trajectory"].in_elements("trajectory_seq")


def test_each_localization_says_where_the_vehicle_is_in_its_own_state():
    assert set(STATES) == set(states_with("truth")) | set(states_with("estimator"))
    first, second = (STATES[name] for name in ODOMETRY.values())
    assert first.header == second.header[: len(first.header)] and len(first.header) == 13
    for localization, name in ODOMETRY.items():
        assert [other for other in ODOMETRY.values() if other in states_with(localization)] == [name]
    for fields in MONITORED_SETS.values():
        assert all(STATES[state].only_with == "" for state, _ in fields)


def test_what_does_not_exist_is_refused_with_what_does():
    with pytest.raises(
        BadInputError, match=r"'planning.magic': not known \(did you mean 'planning.path'\?\); allowed: "
    ):
        find_state("planning.magic")
    with pytest.raises(
        BadInputError, match="state 'planning': is a stage; allowed: planning.path, planning.trajectory"
    ):
        find_state("planning")
    assert unknown("kernel", "planning", KERNELS).endswith("is a stage; allowed: planner, trajectory, waypoint")
    assert unknown("state", "octomap", STATES).startswith("state 'octomap': is a kernel; allowed: sensor.depth")
    with pytest.raises(
        BadInputError, match="state control.command: field 'vw': not known; allowed: vx, vy, vz, yaw_rate"
    ):
        find_state("control.command").find("vw")
