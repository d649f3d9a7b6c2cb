"""Values stored once for compiled functions are the live ones, of the promised kind, and stay alive."""

from typing import NamedTuple

import numpy as np
import pytest

from mavfi.numerics.jit import is_compiled, kernel_jit
from mavfi.numerics.stored import Stored, kind_of, load


class _Table(NamedTuple):
    rows: np.ndarray
    place: np.ndarray


KIND = kind_of(_Table(np.zeros((1, 1)), np.zeros(1, np.int64)), 0.0, np.zeros(1))


@kernel_jit
def _sum(table: _Table, factor: float, added: np.ndarray) -> float:
    table.place[0] += 1
    total = 0.0
    for row in range(table.rows.shape[0]):
        for column in range(table.rows.shape[1]):
            total += factor * table.rows[row, column]
    return total + added[-1]


@kernel_jit
def _sum_at(address: int) -> float:
    table, factor, added = load(address, KIND)
    return _sum(table, factor, added)


needs_compiler = pytest.mark.skipif(not is_compiled(_sum), reason="compilation is off")


@needs_compiler
def test_compiled_code_sees_the_values_by_address():
    table, added = _Table(np.arange(6.0).reshape(2, 3), np.zeros(1, np.int64)), np.array([1.0, 2.0])
    stored = Stored(KIND, table, 3.0, added)
    assert _sum_at(stored.address) == _sum(table, 3.0, added) == 47.0
    table.rows[1, 2], added[-1] = 7.0, 4.0  # the arrays themselves, not copies
    assert _sum_at(stored.address) == 55.0
    assert table.place[0] == 3


@pytest.mark.parametrize(
    "values",
    [
        (_Table(np.zeros((1, 1), np.float32), np.zeros(1, np.int64)), 0.0, np.zeros(1)),
        (_Table(np.zeros((1, 1)), np.zeros(1, np.int64)), 0.0),
    ],
)
def test_values_of_another_kind_are_refused(values: tuple[object, ...]):
    with pytest.raises(TypeError, match="stored values: .*allowed: "):
        Stored(KIND, *values)
