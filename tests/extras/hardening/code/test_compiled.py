"""Machine code of modules: what is inlined, that protected code does as the plain one; copies of arguments."""

import numba
import numpy as np
import pytest

from mavfi.extras.hardening.compiled import code_of, copied, text_of
from mavfi.extras.hardening.duplicate import candidates, protect
from mavfi.ir.build import translate
from mavfi.ir.parser import parse_module
from mavfi.ir.sources import cached_source
from mavfi.kernels.perception.clearance import OCCUPIED, apply_updates
from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.voxels import Grid
from tests.extras.hardening.plans import compiled


def arguments():
    """A map update with voxels at the border and inside, twice the same one, and one outside the grid."""
    ball = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)])
    grid = Grid(0.0, 0.0, 0.0, 1.0, 6, 5, 4)
    voxels, log_odds = np.array([0, 46, 119, 46, -1, 60], np.int32), np.array([1, 1, 1, -1, 1, np.nan], np.float32)
    counters = [np.zeros(120, np.int16) for _ in range(2)]
    return (
        voxels,
        log_odds,
        grid,
        np.zeros(120, np.uint8),
        counters[0],
        ball,
        counters[1],
        ball[9:18],
        np.zeros(6, np.int32),
        np.zeros(6, np.uint8),
    )


@pytest.fixture(scope="module")
def module():
    apply_updates(*arguments())
    source = cached_source(apply_updates, apply_updates.signatures[-1])
    return parse_module(source.text, source.kernel)


def everything(module):
    return protect(module, candidates(module), addresses=False)


def compiled_apart(module):
    """Functions of a module of which its machine code has the name, since they are not inlined everywhere."""
    code = code_of(module)
    return [function.name for function in module.functions if function.name[1:].encode() in code]


def test_functions_of_protected_code_are_inlined(module):
    main, *called = (function.name for function in module.functions)
    assert called and compiled_apart(module) == [main, *called]
    assert compiled_apart(everything(module)) == [main]


@kernel_jit
def copy_into(out, values):
    """Numba's own function composes the message about different shapes."""
    out[1:] = values
    return out.sum()


def test_functions_of_numba_are_not_inlined():
    copy_into(np.zeros(4), np.ones(3))
    source = cached_source(copy_into, copy_into.signatures[-1])
    module = parse_module(source.text, source.kernel)
    library = [function.name for function in module.functions if "@_ZN5numba" in function.name]
    assert library and set(library) <= set(compiled_apart(everything(module)))


def test_plain_code_is_as_numba_makes_it(module):
    assert code_of(module) == translate(text_of(module))


def test_protected_code_does_as_the_plain_one(module):
    plain, protected = arguments(), arguments()
    code = compiled(apply_updates, apply_updates.signatures[-1], everything)
    assert code(*protected) == apply_updates(*plain) == 5
    for plain_result, other in zip(plain, protected, strict=True):
        np.testing.assert_array_equal(plain_result, other)
    assert protected[3][46] != OCCUPIED and protected[3][0] == OCCUPIED


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
