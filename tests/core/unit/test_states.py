import numpy as np
import pytest

from mavfi.errors import BadInputError
from mavfi.states import (
    AUTOPILOTS,
    MONITORED_SETS,
    ODOMETRY,
    PPC_STAGES,
    STATES,
    Stage,
    bytes_of,
    find_state,
    floats,
    new_state,
    rows,
    states_with,
)

WIDTH = {"f8": 8, "f4": 4, "i4": 4, "?": 1}


@pytest.mark.parametrize("name", STATES)
def test_the_leading_floats_of_a_state_share_its_memory(name):
    spec = STATES[name]
    for fields, records, is_header in ((spec.header, 1, True), (spec.elements, 1, False), (spec.elements, 3, False)):
        count = next((i for i, field in enumerate(fields) if field.dtype != "f8"), len(fields))
        if not count:
            continue
        state = new_state(name, records)
        array = state.header if is_header else state.elements
        plain = floats(array, count) if is_header else rows(array, count)
        assert np.shares_memory(plain, array)
        assert plain.shape == ((count,) if is_header else (records, count))
        plain.reshape(records, count)[-1] = np.arange(1.0, count + 1.0)
        assert [array[field.name][-1] for field in fields[:count]] == list(range(1, count + 1))
        assert all(array[field.name][-1] == 0 for field in fields[count:])


@pytest.mark.parametrize("name", STATES)
def test_the_bytes_of_a_header_share_its_memory(name):
    made = new_state(name)
    received = np.frombuffer(made.header.tobytes() * 2, made.header.dtype)[1:]
    for header in (made.header, made.header.copy(), received, np.zeros(2, made.header.dtype)[1:]):
        content = bytes_of(header)
        assert (content.dtype, content.tobytes()) == (np.uint8, header.tobytes())
        assert np.shares_memory(content, header)


def test_no_elements_give_no_rows():
    assert rows(new_state("planning.trajectory").elements, 11).shape == (0, 11)


@pytest.mark.parametrize("name", STATES)
def test_records_are_packed(name):
    spec = STATES[name]
    assert spec.header_dtype.itemsize == sum(WIDTH[field.dtype] for field in spec.header)
    assert spec.element_dtype.itemsize == sum(WIDTH[field.dtype] for field in spec.elements)


@pytest.mark.parametrize("name", STATES)
def test_rows_of_the_table_fit_together(name):
    spec = STATES[name]
    assert name == spec.name and name.split(".")[0] == spec.stage.value
    assert bool(spec.elements) == bool(spec.element)
    assert not spec.acted_on or spec.find(spec.acted_on).dtype == "i4"
    for fields in (spec.header, spec.elements):
        assert len({field.name for field in fields}) == len(fields)
        assert all(field.unit and set(field.read_in) <= set(AUTOPILOTS) for field in fields)


def test_every_stage_of_the_paper_writes_states():
    assert {spec.stage for spec in STATES.values()} == {Stage.SENSOR, *PPC_STAGES}


@pytest.mark.parametrize(("name", "size"), [("paper-13", 13), ("published-19", 19)])
def test_monitored_sets_have_their_size_and_exist(name, size):
    monitored = MONITORED_SETS[name]
    assert len(monitored) == len(set(monitored)) == size
    for state, field in monitored:
        STATES[state].find(field)


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
    assert not STATES["planning.trajectory"].in_elements("trajectory_seq")


def test_dead_fields_are_listed_by_autopilot():
    field = STATES["planning.waypoint"].find("ax")
    assert field.dead_in("published") and not field.dead_in("hardened")


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
        BadInputError, match=r"no state 'planning.magic' \(did you mean 'planning.path'\?\); allowed: sensor"
    ):
        find_state("planning.magic")
    with pytest.raises(BadInputError, match="state control.command: no field 'vw'; allowed: vx, vy, vz, yaw_rate"):
        find_state("control.command").find("vw")
