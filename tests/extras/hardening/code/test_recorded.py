"""Copies of arguments keep what selects a compiled signature, and what two arguments share."""

from pathlib import Path

import numba
import numpy as np

from mavfi.extras.hardening.battery import CallRecording, copied, same_bits
from mavfi.faults.levels.instruction.api import digest
from mavfi.ir.forked import run_in_child


def test_copies_keep_values_strides_access_and_signature():
    table = np.arange(24.0).reshape(4, 6)
    fixed = np.arange(3)
    fixed.flags.writeable = False
    args = (table[:, 1], table[::2, ::3], fixed, 2.5, np.zeros((0, 3)))
    other = copied(args)
    assert numba.typeof(other) == numba.typeof(args)
    assert [a.strides for a in other if isinstance(a, np.ndarray)] == [
        a.strides for a in args if isinstance(a, np.ndarray)
    ]
    np.testing.assert_equal(other, args)
    other[0][:] = -1
    assert table.min() == 0
    assert other[1][0, 0] == 0 and np.shares_memory(other[0], other[1]) is False  # no common element


def test_arrays_that_share_memory_share_it_in_the_copy():
    table = np.arange(6.0)
    first, second = copied((table[:4], table[2:]))
    first[2] = 9.0
    assert second[0] == 9.0 and table[2] == 2.0


def test_recorded_calls_are_spread_evenly_and_taken_before_the_call():
    recording, value = CallRecording(4), np.zeros(1)
    for number in range(100):
        recording.note((value,))
        value += 1
        assert recording.total == number + 1
    calls = sorted(recording.arguments)
    assert 4 <= len(calls) <= 8 and len(set(np.diff(calls))) == 1 and calls[0] == 0
    assert all(recording.arguments[call][0][0] == call for call in calls)


def test_large_recorded_arrays_are_in_memory_that_forks_share_and_nothing_writes():
    """Faults are injected in forks: to copy the page tables of all recordings for each would take most of the time."""
    recording, large = CallRecording(), np.arange(1e5)
    recording.note((large, large[7:]))
    array, part = recording.arguments[0]
    np.testing.assert_equal(array, large)
    assert np.shares_memory(array, part) and numba.typeof(array) == numba.typeof(large)
    assert _permissions(array) == "r--s" and _permissions(copied(array)) == "rw-p"

    def write():
        array[0] = 1.0
        return b""

    assert run_in_child(write).detail == "SIGSEGV" and array[0] == 0.0


def _permissions(array):
    """Those of the mapping in which an array lies, as in /proc/self/maps."""
    for line in Path("/proc/self/maps").read_text(encoding="ascii").splitlines():
        start, end = (int(text, 16) for text in line.split()[0].split("-"))
        if start <= array.ctypes.data < end:
            return line.split()[1]
    return ""


def test_equal_bits_are_those_of_equal_digests():
    table = np.arange(24.0).reshape(4, 6)
    nan = np.frombuffer(np.array([0x7FF8000000000001], np.uint64), np.float64)
    values = [
        0.0,
        -0.0,
        1.0,
        1,
        None,
        float("nan"),
        np.float32(1.0),
        (1.0, table),
        (1.0, table + 0.0),
        (1.0, -table),
        table,
        table[::2, ::3],
        table[::2, ::3].copy(),
        table[:, :1],
        table.astype(np.float32),
        np.zeros((0, 3)),
        np.array([np.nan]),
        nan,
        np.array([-0.0]),
        np.array([0], np.uint8),
    ]
    for one in values:
        assert same_bits(one, copied(one))
        for other in values:
            assert same_bits(one, other) == (digest(one) == digest(other)), (one, other)
