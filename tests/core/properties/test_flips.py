import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mavfi.faults.changes import ValueChange
from mavfi.faults.fault import FaultSite
from mavfi.faults.operations import Operation
from mavfi.faults.strata import WORD_BITS
from mavfi.levels.state.carriers import StateField
from mavfi.states import STATES, State

SITES = [(spec, field) for spec in STATES.values() for field in dict.fromkeys(field.name for field in spec.fields)]


def flip(state, site, bit):
    """A copy of a state with a flipped bit, and the value before and after."""
    changed = state.copy()
    row = 0
    if state.spec.in_elements(site.field):
        row = site.element
    return changed, *ValueChange(Operation("flip", bit=bit)).apply(StateField(changed, site.field, row))


@st.composite
def strikes(draw):
    spec, name = draw(st.sampled_from(SITES))
    count = draw(st.integers(1, 5)) if spec.elements else 0
    random = np.random.default_rng(draw(st.integers(0, 2**32)))

    def content(dtype, n):
        raw = np.frombuffer(random.bytes(dtype.itemsize * n), np.uint8).copy()
        state = raw.view(dtype) if n else np.zeros(0, dtype)
        for flag in (field for field in dtype.names or () if dtype[field] == np.bool_):
            state[flag] = random.integers(2, size=n)  # a flag's byte is 0 or 1
        return state

    state = State(spec, content(spec.header_dtype, 1), content(spec.element_dtype, count))
    element = draw(st.integers(0, count - 1)) if spec.in_elements(name) else None
    bit = draw(st.integers(0, WORD_BITS[spec.find(name).dtype] - 1))
    return state, FaultSite(spec.name, name, element), bit


def bits(state: State) -> np.ndarray:
    return np.unpackbits(np.frombuffer(state.header.tobytes() + state.elements.tobytes(), np.uint8), bitorder="little")


@given(strikes())
def test_a_flip_changes_exactly_one_bit_of_the_field_and_a_second_one_restores_it(strike):
    state, site, bit = strike
    original = state.copy()
    struck, _, _ = flip(state, site, bit)
    assert state.same_bits(original)
    [changed] = np.flatnonzero(bits(struck) != bits(state))
    assert changed == expected_place(state, site) * 8 + bit
    assert flip(struck, site, bit)[0].same_bits(original)


def expected_place(state: State, site: FaultSite) -> int:
    """Byte at which the field begins, header first; fields are packed."""
    in_elements = state.spec.in_elements(site.field)
    fields = state.spec.elements if in_elements else state.spec.header
    before = fields[: [field.name for field in fields].index(site.field)]
    offset = sum(np.dtype(field.dtype).itemsize for field in before)
    start = len(state.header.tobytes()) + (site.element or 0) * state.spec.element_dtype.itemsize if in_elements else 0
    return start + offset


@given(strikes())
def test_no_mask_changes_nothing(strike):
    state, site, _ = strike
    struck, before, after = flip(state, site, None)
    assert struck.same_bits(state)
    assert struck is not state
    assert np.array_equal(before, after, equal_nan=isinstance(before, float))
