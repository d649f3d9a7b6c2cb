from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavfi.errors import BadInputError
from mavfi.faults.changes import ValueChange
from mavfi.faults.fault import NO_SITE, FaultSite
from mavfi.faults.operations import Operation
from mavfi.levels.state.carriers import StateField
from mavfi.levels.state.fault import StateFault
from mavfi.levels.state.injector import StateInjector
from mavfi.states import State, new_state

WAYPOINT = FaultSite("planning.waypoint", "x")


def flip(state, site, bit):
    """A copy of a state with a flipped bit, and the value before and after."""
    changed = state.copy()
    row = 0
    if state.spec.in_elements(site.field):
        row = site.element
    return changed, *ValueChange(Operation("flip", bit=bit)).apply(StateField(changed, site.field, row))


def waypoint(x=50.0) -> State:
    state = new_state("planning.waypoint")
    state.header["x"] = x
    return state


def trajectory(count: int) -> State:
    state = new_state("planning.trajectory", count)
    state.elements["y"] = 10.0 + np.arange(count)
    return state


def collision_status(seq: int, time=12.0) -> State:
    state = new_state("perception.collision_status")
    state.header["future_collision_seq"] = seq
    state.header["time_to_collision"] = time
    return state


@pytest.mark.parametrize(
    ("bit", "after"), [(63, -50.0), (62, 50.0 * 2.0**-1024), (52, 100.0), (51, 34.0), (0, 50.000000000000007)]
)
def test_flip_changes_the_bit_that_ieee_754_says(bit, after):
    state = waypoint()
    changed, before, value = flip(state, WAYPOINT, bit)
    assert (before, value) == (50.0, after)
    assert changed.header["x"][0] == after
    assert state.header["x"][0] == 50.0


def test_flip_inverts_a_flag_and_changes_an_integer_in_twos_complement():
    state = collision_status(5)
    assert flip(state, FaultSite("perception.collision_status", "collision"), 0)[1:] == (False, True)
    assert flip(state, FaultSite("perception.collision_status", "future_collision_seq"), 31)[1:] == (5, 5 - 2**31)


def test_flip_injects_the_element_and_nothing_else():
    state = trajectory(4)
    changed, before, after = flip(state, FaultSite("planning.trajectory", "y", 2), 63)
    assert (before, after) == (12.0, -12.0)
    assert changed.elements["y"].tolist() == [10.0, 11.0, -12.0, 13.0]
    differing = np.frombuffer(changed.elements.tobytes(), np.uint8) != np.frombuffer(state.elements.tobytes(), np.uint8)
    assert differing.sum() == 1


@pytest.mark.parametrize(
    ("site", "message"),
    [
        (FaultSite("planning.nowhere", "x"), "state 'planning.nowhere': not known"),
        (FaultSite("planning.waypoint", "roll"), "field 'roll': not known"),
    ],
)
def test_what_is_not_there_is_not_flipped(site, message):
    with pytest.raises(BadInputError, match=message):
        StateInjector(StateFault(site))


def test_null_fault_goes_the_whole_path_and_changes_nothing():
    injector = StateInjector(StateFault(WAYPOINT, 0, None))
    state = waypoint()
    passed = injector(state, 40_000)
    assert passed is not state
    assert passed.same_bits(state)
    [injection] = injector.finish()
    assert injection.activated
    assert injection.bit is None
    assert injection.before == injection.after == 50.0


def test_a_publication_that_never_comes_is_reported_as_not_activated():
    injector = StateInjector(StateFault(WAYPOINT, 5_000_000, 3))
    injector(waypoint(), 4_000_000)
    [injection] = injector.finish()
    assert not injection.activated
    assert injection.before is None
    assert injection.time_s == 5.0
    without_site = StateInjector(StateFault(WAYPOINT, NO_SITE, 3))
    state = waypoint()
    assert without_site(state, 0) is state and not without_site.finish()[0].activated


def test_event_states_are_struck_only_when_consumers_act_on_them():
    site = FaultSite("perception.collision_status", "time_to_collision")
    injector = StateInjector(StateFault(site, 1_000_000, 63))
    sequence = [(0, 0), (1, 500_000), (1, 1_000_000), (1, 1_500_000), (2, 2_000_000), (3, 2_500_000)]
    times = [time for seq, time in sequence if injector(collision_status(seq), time).header[site.field][0] < 0]
    assert times == [2_000_000]


# ---- faults that last -----------------------------------------------------------------------------------------------
PERIOD_US = 20_000


def lasting_values(fault, values) -> list[int]:
    """Words of the way-points that consumers see, published at the control period."""
    injector, seen = StateInjector(fault), []
    for number, value in enumerate(values):
        state = injector(waypoint(value), number * PERIOD_US)
        seen.append(int(state.header["x"].view(np.uint64)[0]))
    return seen


def expected_values(fault, values) -> list[int]:
    """The same, from the definition, without a share."""
    words = [int(np.array([value]).view(np.uint64)[0]) for value in values]
    first = next((index for index in range(len(words)) if index * PERIOD_US >= fault.time_us), len(words))
    mask = sum(1 << bit for bit in range(fault.bit, fault.bit + fault.width))
    for index in range(first, len(words)):
        if index == first:
            stuck = ~words[index] & mask
        in_time = (index - first) * PERIOD_US <= 1e6 * fault.lasts_s
        if index - first < fault.times or in_time:
            words[index] = words[index] & ~mask | stuck
    return words


@given(
    st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=12),
    st.integers(0, 60),
    st.integers(1, 4),
    st.integers(1, 4),
    st.sampled_from([0.0, 0.02, 0.05, float("inf")]),
    st.integers(0, 250_000),
)
def test_a_fault_that_lasts_sticks_as_its_definition_says(values, bit, width, times, lasts_s, time_us):
    fault = StateFault(WAYPOINT, time_us, bit, lasts_s=lasts_s, width=width, times=times)
    assert lasting_values(fault, values) == expected_values(fault, values)


def test_an_intermittent_fault_hits_its_share_and_the_seed_says_which():
    values = [float(number) for number in range(1, 2001)]

    def hits(seed, share=0.3):
        fault = StateFault(WAYPOINT, 0, 63, seed=seed, lasts_s=float("inf"), share=share)
        return [word >> 63 for word in lasting_values(fault, values)]

    assert hits(1) == hits(1) and hits(1) != hits(2) and hits(1)[0] == hits(2)[0] == 1
    assert abs(sum(hits(1)) - 600) < 5 * np.sqrt(2000 * 0.3 * 0.7)
    assert all(hits(1, 1.0))


def test_the_record_counts_what_was_changed_and_says_when_it_is_over():
    fault = StateFault(WAYPOINT, 0, 63, lasts_s=0.05)
    injector = StateInjector(fault)
    for number in range(3):
        injector(waypoint(), number * PERIOD_US)
    copy = injector.copy()
    assert not injector.spent
    assert injector(state := waypoint(), 3 * PERIOD_US) is state and injector.spent and not copy.spent
    [injection] = injector.finish()
    assert injection.details == {"publications": 3} and (injection.before, injection.after) == (50.0, -50.0)
    assert copy(waypoint(), 50_000).header["x"][0] == -50.0 and copy.finish()[0].details == {"publications": 4}
    assert StateInjector(StateFault(WAYPOINT, 0, 63)).finish()[0].details == {}


def test_a_vector_is_hit_in_one_publication_and_recorded_before_and_after():
    fault = StateFault(FaultSite("planning.trajectory", "y", 2), 0, 63, also=(("x", 52), ("z", 62)))
    injector = StateInjector(fault)
    struck = injector(trajectory(4), 0)
    assert struck is not None
    assert struck.elements["y"].tolist() == [10.0, 11.0, -12.0, 13.0]
    assert struck.elements["x"].tolist() == [0.0, 0.0, 2.0**-1022, 0.0]
    assert struck.elements["z"].tolist() == [0.0, 0.0, 2.0, 0.0]
    assert injector(trajectory(4), 1).same_bits(trajectory(4)), "once"
    (injection,) = injector.finish()
    assert (injection.before, injection.after, injection.activated) == (12.0, -12.0, True)
    assert injection.details["also"] == [
        {"field": "x", "bit": 52, "before": 0.0, "after": 2.0**-1022},
        {"field": "z", "bit": 62, "before": 0.0, "after": 2.0},
    ]
    infinite = replace(fault, also=(("duration", 62),))
    state = trajectory(4)
    state.elements["duration"] = 1.0
    injector = StateInjector(infinite)
    injector(state, 0)
    assert injector.finish()[0].details["also"][0]["after"] == "inf", "as JSON can represent it"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lasts_s": 1.0}, "also: 1 further fields: allowed: in one bit of one publication"),
        ({"width": 2}, "allowed: in one bit of one publication"),
        ({"bit": None}, "allowed: in one bit of one publication"),
        ({"also": (("x", 3),)}, "also: 'x': no other field, or named twice; allowed: y, z, yaw"),
        ({"also": (("y", 3), ("y", 4))}, "also: 'y': no other field, or named twice; allowed: z"),
        ({"also": (("y", 64),)}, "also: y: bit 64; allowed: 0 to 63"),
    ],
)
def test_further_fields_that_cannot_be_changed_are_refused(change, message):
    with pytest.raises(BadInputError, match=message.replace("(", r"\(")):
        replace(StateFault(WAYPOINT, 0, 1, also=(("y", 3),)), **change)
