"""Faults of all levels are one union of plain data."""

import json
from dataclasses import FrozenInstanceError

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavfi.errors import BadInputError
from mavfi.faults.fault import (
    ACCESSES,
    MAX_TIMEOUT_S,
    MAX_WALK,
    MODELS,
    NO_SITE,
    REGISTERS,
    FaultSite,
    InstructionFault,
    MemoryFault,
    MessageFault,
    RegisterFault,
    StateFault,
    fault_from_json,
    find_level,
)
from mavfi.faults.levels.sensor.fault import TYPES, UNITS, SensorFault
from mavfi.faults.strata import WORD_BITS
from mavfi.states import KERNELS, STATES

seeds = st.integers(0, 2**63 - 1)
fields = [(spec.name, field.name) for spec in STATES.values() for field in spec.fields]
sites = st.builds(
    lambda place, element: FaultSite(*place, element), st.sampled_from(fields), st.none() | st.integers(0, 99)
)


def _field(fault):
    return STATES[fault.where.state].find(fault.where.field)


state_faults = st.builds(
    StateFault,
    sites,
    st.just(NO_SITE) | st.integers(0, 10**9),
    st.none() | st.integers(0, 63),
    st.sampled_from(["", "mantissa"]),
    st.floats(0, 1),
    seeds,
    st.sampled_from([0.0, 0.5, float("inf")]),
    st.floats(0, 1, exclude_min=True),
    st.integers(1, 3),
    st.integers(1, 3),
).filter(lambda fault: fault.bit is None or fault.bit + fault.width <= WORD_BITS[_field(fault).dtype])
instruction_faults = st.builds(
    InstructionFault,
    st.text(),
    st.text(),
    st.integers(0),
    st.just(NO_SITE) | st.integers(0),
    st.lists(st.integers(0, 127), max_size=3).map(tuple),
    st.integers(0, 2**128),
    st.integers(0),
    model=st.sampled_from(MODELS),
    kernel=st.text(),
    entry=st.text(),
    seed=seeds,
    weight=st.floats(0, 9),
)
memory_faults = st.builds(
    MemoryFault,
    st.sampled_from(list(KERNELS)),
    st.text(),
    st.none() | st.integers(0, 99),
    st.sampled_from(list(WORD_BITS)),
    st.just(NO_SITE) | st.integers(0, 10**9),
    st.none() | st.just(0),
    st.sampled_from(["", "mantissa"]),
    st.floats(0, 1),
    seeds,
)
message_faults = st.builds(
    MessageFault,
    st.text(),
    st.text(),
    st.none() | st.integers(0, 63),
    st.integers(1, 10**6),
    st.none() | st.floats(0, 1, exclude_min=True),
    seed=seeds,
)
register_faults = st.builds(
    RegisterFault,
    st.sampled_from(REGISTERS),
    st.sampled_from(ACCESSES),
    st.text(),
    st.just(0),
    st.integers(1, MAX_WALK),
    st.floats(0, MAX_TIMEOUT_S, exclude_min=True),
    st.booleans(),
    st.text(),
    seed=seeds,
)
sensor_faults = st.builds(
    SensorFault,
    st.sampled_from(list(UNITS)),
    st.sampled_from(list(TYPES)),
    st.just(NO_SITE) | st.integers(0, 10**9),
    st.floats(0, exclude_min=True),
    seed=seeds,
)
faults = state_faults | memory_faults | instruction_faults | message_faults | register_faults | sensor_faults


@given(faults)
def test_a_fault_of_any_level_survives_json(fault):
    again = fault_from_json(json.loads(json.dumps(fault.to_json(), allow_nan=False)))
    assert again == fault and type(again) is type(fault)
    assert hash(again) == hash(fault)


@given(faults)
def test_every_fault_says_its_level_its_bit_and_whether_it_has_a_site(fault):
    data = fault.to_json()
    assert find_level(fault.level).fault is type(fault)
    assert fault.has_site == (NO_SITE not in (data.get("time_us"), data.get("call")))
    assert fault.bit == (data["bits"][0] if len(data.get("bits", ())) == 1 else data.get("bit"))


def test_a_fault_is_data():
    with pytest.raises(FrozenInstanceError):
        StateFault(FaultSite("control.command", "vx")).bit = 3


def test_what_only_lasting_faults_have_is_left_out_of_the_others():
    once = StateFault(FaultSite("control.command", "vx"), 5, 62)
    assert list(once.to_json()) == ["level", "where", "time_us", "bit", "stratum", "weight", "seed"]
    assert not once.lasting and not StateFault(FaultSite("control.command", "vx"), width=2).lasting
    stuck = StateFault(FaultSite("control.command", "vx"), 5, 62, lasts_s=float("inf"), times=2)
    assert stuck.lasting and stuck.to_json() == {**once.to_json(), "lasts_s": "inf", "times": 2}


def test_sites_as_text():
    assert StateFault(FaultSite("planning.path", "x", 2)).site == "planning.path.x[2]"
    assert StateFault(FaultSite("control.command", "vx")).site == "control.command.vx"
    assert MemoryFault("planner", "decisions.acted_seq").site == "memory:planner.decisions.acted_seq"
    assert MemoryFault("waypoint", "points", 12).site == "memory:waypoint.points[12]"
    assert SensorFault("motor", "off", instance=2).site == "motor2 off"
    assert SensorFault("gyro", "drift").site == "gyro drift"
    assert InstructionFault("m.f", "sha", 1, kernel="pid", entry="track").site == "pid.track"
    assert InstructionFault("m.f", "sha", 1).site == "m.f"
    assert MessageFault("/joints", "position[0]").site == "/joints.position[0]"
    assert (RegisterFault("fp", node="planner").site, RegisterFault("fp").site) == ("planner:fp", "fp")


def test_a_draw_without_a_site_says_so():
    assert not StateFault(FaultSite("control.command", "vx"), NO_SITE).has_site
    assert not InstructionFault("f", "", 0, NO_SITE).has_site
    assert StateFault(FaultSite("control.command", "vx")).has_site and InstructionFault("f", "", 0).has_site


@given(st.lists(st.integers(0, 63), min_size=1, max_size=4, unique=True), st.integers(0, 2**64 - 1))
def test_bits_are_flipped_or_the_whole_value_is_replaced(bits, value):
    for fault, wanted in (
        (InstructionFault("f", "", 0, bits=tuple(bits)), lambda v: v ^ sum(1 << bit for bit in bits)),
        (InstructionFault("f", "", 0, value=value), lambda v: value),
    ):
        keep, flip = fault.masks
        for before in (0, 2**64 - 1, value):
            assert (before & keep) ^ flip == wanted(before)
    assert InstructionFault("f", "", 0, bits=tuple(bits)).bit == (bits[0] if len(bits) == 1 else None)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: StateFault(FaultSite("a", "x"), lasts_s=-1.0), "lasts_s: -1.0: allowed: 0 or more"),
        (lambda: StateFault(FaultSite("a", "x"), lasts_s=float("nan")), "lasts_s: nan: allowed: 0 or more"),
        (lambda: StateFault(FaultSite("a", "x"), share=0.0), "share: 0.0: allowed: above 0, to 1"),
        (lambda: StateFault(FaultSite("a", "x"), width=0), "width: 0: allowed: 1 or more"),
        (lambda: StateFault(FaultSite("a", "x"), times=0), "times: 0: allowed: 1 or more"),
        (
            lambda: fault_from_json({**StateFault(FaultSite("control.command", "vx"), bit=63, width=2).to_json()}),
            "bit 63; allowed: 0 to 62",
        ),
        (lambda: MemoryFault("pilot", "x"), "'pilot': allowed: state_estimation, point_cloud"),
        (lambda: MemoryFault("pid", "law", 0, "f2"), "'f2': allowed: f8, f4"),
        (lambda: MemoryFault("pid", "fresh", None, "?", bit=1), "bit 1; allowed: 0 to 0"),
        (lambda: MessageFault("t", "f", at=0), "at: 0: allowed: 1 or more"),
        (lambda: MessageFault("t", "f", rate=0.0), "rate: 0.0: allowed: above 0, to 1"),
        (lambda: RegisterFault("vector"), "registers: 'vector': allowed: all, general, fp"),
        (lambda: RegisterFault(access="both"), "access: 'both': allowed: either, read, write"),
        (lambda: RegisterFault(walk=-1), "walk: -1: allowed: 0 to 100000"),
        (lambda: RegisterFault(timeout=0.0), "timeout: 0.0: allowed: above 0, to 3600 s"),
        (lambda: RegisterFault(thread=1), "thread: 1: allowed"),
        (lambda: fault_from_json({"level": "planet"}), "level 'planet': not known; allowed: state, memory"),
        (lambda: fault_from_json({}), "level None: not known"),
    ],
)
def test_what_is_not_allowed_is_named(make, message):
    with pytest.raises(BadInputError) as caught:
        make()
    assert message in str(caught.value)
