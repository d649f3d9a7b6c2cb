"""Operations and triggers: schedules against lists, numbers against NumPy, texts against what they were made of."""

import math
import pickle
import warnings
from itertools import product

import numpy as np
import pytest

from mavfi.errors import BadInputError
from mavfi.faults.changes import Change, Condition, MessageSchedule, When, happens, parse_text
from mavfi.faults.operations import OPERATIONS, Operation, changed_number

TIMES = [0.0, 0.5, 1.0, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0]
VALUES = [0, 0, 3, 0, 3, 3, 0, 3, 0, 0]
"""Instants of ten messages, and a number in each."""


def due(when, seed=0, schedule=None):
    schedule = schedule or MessageSchedule(when, seed)
    return [schedule.due(time, lambda _, value=value: value) for time, value in zip(TIMES, VALUES, strict=True)]


def expected(when, seed=0):
    """The same from the definition, over the whole list at once."""
    holds = [when.condition is None or value > when.condition.value for value in VALUES]
    can_begin = [
        number + 1 >= when.first and time >= when.start_s and holds[number] for number, time in enumerate(TIMES)
    ]
    if True not in can_begin:
        return [False] * len(TIMES)
    first = can_begin.index(True)
    selected = [
        number
        for number, time in enumerate(TIMES)
        if number >= first
        and (number - first) % when.every == 0
        and time <= when.end_s
        and happens(seed, number + 1, when.share)
    ]
    if TIMES[first] > when.end_s:
        selected = []
    if when.times:
        selected = selected[: when.times]
    return [number in selected for number in range(len(TIMES))]


@pytest.mark.parametrize("seed", range(2))
def test_a_schedule_selects_what_its_definition_says(seed):
    conditions = [None, Condition("x", ">", 2.0), Condition("x", ">", 9.0)]
    spans = [(0.0, math.inf), (1.0, math.inf), (1.0, 3.0), (9.0, 10.0)]
    grid = product([1, 4, 11], spans, conditions, [0, 1, 3], [1, 2], [1.0, 0.5])
    for first, (start, end), condition, times, every, share in grid:
        when = When(first, start, end, False, condition, times, every, share)
        assert due(when, seed) == expected(when, seed), when


def test_a_schedule_is_over_when_nothing_can_follow():
    schedule = MessageSchedule(When(times=0, end_s=2.0))
    assert [(schedule.due(time, lambda _: 0.0), schedule.is_over) for time in (1.0, 2.0, 2.5, 3.0)] == [
        (True, False),
        (True, False),
        (False, True),
        (False, True),
    ]


def test_a_share_is_a_probability_that_depends_on_seed_and_message():
    counts = [sum(happens(seed, number, 0.3) for number in range(10_000)) for seed in range(5)]
    assert len(set(counts)) > 1 and all(abs(count - 3000) < 5 * math.sqrt(10_000 * 0.3 * 0.7) for count in counts)


# ---- numbers ---------------------------------------------------------------------------------------------------------
ARITHMETIC = {"set": lambda value, operand: operand, "bias": np.add, "scale": np.multiply}


@pytest.mark.parametrize("dtype", ["f8", "f4"])
@pytest.mark.parametrize("name", ARITHMETIC)
def test_real_numbers_change_as_numpy_computes(name, dtype):
    kind = np.dtype(dtype).type
    for value, operand in product([0.0, -1.5, 3e38, np.inf, np.nan], [2.0, -0.25, 1e30, 1e300]):
        before = float(kind(value))
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            after = float(kind(ARITHMETIC[name](np.float64(before), np.float64(operand))))
        assert np.array_equal(changed_number(Operation(name, operand), before, dtype), after, equal_nan=True)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, -0.0])
def test_any_number_can_be_set(value):
    after = changed_number(Operation("set", value), 1.0, "f8")
    assert math.copysign(1.0, after) == math.copysign(1.0, value)
    assert after == value or math.isnan(after) and math.isnan(value)


def test_whole_numbers_are_rounded_and_limited_and_flags_are_set():
    assert changed_number(Operation("scale", 0.6), 3, "i4") == 2
    assert changed_number(Operation("bias", 1e12), 3, "i4") == 2**31 - 1
    assert changed_number(Operation("bias", -300.0), 3, "u1") == 0
    assert changed_number(Operation("set", 1.0), False, "?") is True
    assert changed_number(Operation("flip", bit=0), True, "?") is False


@pytest.mark.parametrize("dtype", ["f8", "f4", "i4", "u1", "i8"])
def test_a_flip_inverts_its_bit_alone(dtype):
    word = np.array([37]).astype(dtype)
    for bit in range(8 * word.itemsize):
        after = np.array([changed_number(Operation("flip", bit=bit), word[0].item(), dtype)]).astype(dtype)
        difference = int.from_bytes(after.tobytes(), "little") ^ int.from_bytes(word.tobytes(), "little")
        assert difference == 1 << bit


@pytest.mark.parametrize(
    ("operation", "dtype", "message"),
    [
        (Operation("set", math.nan), "i4", "set=nan: allowed: whole numbers from -2147483648"),
        (Operation("set", 0.5), "u1", "set=0.5: allowed: whole numbers from 0 to 255"),
        (Operation("bias", 1.0), "?", "bias=1: it is a flag; allowed: flip, set=0, set=1"),
        (Operation("flip", bit=32), "f4", "bit 32: allowed: 0 to 31"),
        (Operation("drop"), "f8", "drop: changes no single number; allowed: flip, set, bias, scale"),
    ],
)
def test_what_a_type_does_not_allow_is_refused(operation, dtype, message):
    with pytest.raises(BadInputError, match=message):
        changed_number(operation, 1, dtype)


# ---- text ------------------------------------------------------------------------------------------------------------
TEXTS = [
    "bit=30@10",
    "set=nan@10..12",
    "bias=0.12345678901234566:times=0:every=5@10",
    "scale=-1e-300:share=0.1@linear.x>0.5",
    "bias=0.5:times=0:lasts=2.0@10",
    "drop@n=100",
    "delay=0.2:times=20@0",
    "duplicate=3:times=7@sim=3.25..4",
    "reorder=2@trajectory_seq>=2",
    "freeze@1",
    "freeze:times=1@1",
    "freeze@1..2",
    "set=-0@0",
]


@pytest.mark.parametrize("text", TEXTS)
def test_a_text_is_written_as_it_was_read(text):
    change = parse_text(text)
    assert str(change) == text and parse_text(str(change)) == change
    assert pickle.loads(pickle.dumps(change)) == change and len({change, parse_text(text)}) == 1


def test_texts_may_leave_out_what_is_usual():
    assert parse_text("set=1") == Change(Operation("set", 1.0), When())
    assert parse_text("drop@3") == Change(Operation("drop"), When(start_s=3.0))
    assert parse_text("drop@3..") == Change(Operation("drop"), When(start_s=3.0, times=0))
    assert parse_text("drop@3..5") == Change(Operation("drop"), When(start_s=3.0, end_s=5.0, times=0))
    assert parse_text("freeze@3") == Change(Operation("freeze"), When(start_s=3.0, times=0))
    assert parse_text("duplicate") == Change(Operation("duplicate", 1.0), When())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not known; allowed: bit=, flip, set"),
        ("set", "set: needs a number; allowed: set=a number, nan, inf or -inf"),
        ("bias=inf", "bias: inf: allowed: finite numbers"),
        ("drop:freeze", "'freeze': allowed: one operation, each option once"),
        ("delay=0", "delay: 0.0: allowed: above 0, to 3600 s"),
        ("drop:share=2", "share: 2.0: allowed: above 0, to 1"),
        ("drop@n=0", "first: 0: allowed: 1 or more"),
        ("drop@5..3", "instant '5..3': ends before it starts; allowed: 10, 10..12"),
        ("drop@x>nan", "x>nan: allowed: finite numbers"),
    ],
)
def test_what_is_no_change_is_refused_in_one_line(text, message):
    with pytest.raises(BadInputError, match=message):
        parse_text(text)


def test_every_operation_has_a_text():
    assert {parse_text(text).operation.name for text in TEXTS} == set(OPERATIONS)
