"""The key of compiled code: any change that alters machine code changes it, comments and other functions do not."""

import importlib.util
import sys

import numpy as np
import pytest
from numba.core import types
from numba.typed import List as TypedList

from mavfi.numerics.dependencies import UnknownDependencyError, content_digest, signature_digest
from mavfi.numerics.stored import load
from tests.core.unit.faults.instruction.kernels import closure

CALLEES = '''
import math
from typing import NamedTuple

import numpy as np

from mavfi.numerics.jit import kernel_jit

LIMIT = 4
TABLE = np.array([1.0, 2.0])
KIND = np.dtype([("x", "f8"), ("y", "i4")])


class Pair(NamedTuple):
    first: float
    second: float = 2.0


@kernel_jit
def inner(x, scale=2.0):
    """A docstring."""
    if x > LIMIT:
        return x * scale
    return math.sqrt(x) + TABLE[0]


@kernel_jit
def pair_of(x):
    return Pair(x, sum([value * 2.0 for value in TABLE]))


@kernel_jit
def apart(x):
    return x + 1.0
'''
KERNEL = """
import {callees} as callees
from mavfi.numerics.jit import kernel_jit
from {callees} import inner, pair_of


@kernel_jit
def kernel(x):
    return inner(x) + pair_of(x).second + callees.LIMIT
"""


def loaded(path, name, text):
    path.mkdir(exist_ok=True)
    file = path / f"{name}.py"
    file.write_text(text, encoding="utf-8")
    spec = importlib.util.spec_from_file_location(name, file)
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def key(tmp_path):
    """Key of the kernel that calls the functions of a text, in modules of new names."""
    count = iter(range(100))

    def made(*replaced):
        callees, number = CALLEES, next(count)
        for old, new in zip(replaced[::2], replaced[1::2], strict=True):
            assert old in callees
            callees = callees.replace(old, new)
        name = f"callees_{number}"
        loaded(tmp_path, name, callees)
        kernel = loaded(tmp_path, f"kernel_{number}", KERNEL.format(callees=name)).kernel
        return content_digest(kernel)

    return made


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("LIMIT = 4", "LIMIT = 5"),
        ("LIMIT = 4", "LIMIT = 4.0"),
        ("[1.0, 2.0]", "[1.0, 2.5]"),
        ("x * scale", "x / scale"),
        ("scale=2.0", "scale=3.0"),
        ("math.sqrt", "math.exp"),
        ("value * 2.0", "value * 3.0"),
        ("second: float = 2.0", "third: float = 2.0"),
    ],
)
def test_a_change_in_a_callee_changes_the_key_of_its_caller(key, old, new):
    assert key(old, new) != key()


def test_comments_docstrings_layout_modules_and_other_functions_change_no_key(key):
    assert (
        key(
            '"""A docstring."""',
            '"""Another docstring,\n\n    of more lines.\n    """',
            "    if x > LIMIT",
            "    # A comment.\n\n    if x > LIMIT",
            "math.sqrt(x) + TABLE[0]",
            "(\n        math.sqrt(x)\n        + TABLE[0]  # first\n    )",
            "return x + 1.0",
            "return x - 1.0",
            "import math\n",
            '"""A module."""\n\nimport math\n',
        )
        == key()
    )


def test_a_constant_that_is_replaced_changes_the_key(tmp_path):
    module = loaded(tmp_path, "replaced_constant", CALLEES)
    before = content_digest(module.inner)
    assert content_digest(module.inner) == before
    module.LIMIT = 7
    assert content_digest(module.inner) != before


def test_values_of_enclosing_functions_are_in_the_key():
    arrays = np.zeros(3), np.ones(3), np.zeros(3, np.float32)
    values = (1.0, 2.0, 2, True, None, *arrays, types.float64, closure(1.0), closure(2.0), load)
    keys = {content_digest(closure(value)) for value in values}
    assert len(keys) == len(values)
    assert content_digest(closure(2.0)) == content_digest(closure(2.0))


def test_a_value_of_an_unknown_kind_has_no_key():
    with pytest.raises(UnknownDependencyError):
        content_digest(closure(TypedList.empty_list(types.float64)))
    with pytest.raises(UnknownDependencyError):
        content_digest(closure({"a": 1.0}))


def test_types_of_arguments_differ_by_the_names_of_their_fields(tmp_path):
    def signature(number, *replaced):
        pair = loaded(tmp_path, f"pairs_{number}", CALLEES.replace(*replaced)).Pair
        return (types.NamedTuple((types.float64, types.float64), pair),)

    first, second = signature(1, "first", "first"), signature(2, "first", "other")
    assert str(first) == str(second)
    assert signature_digest(first) != signature_digest(second)
    assert signature_digest(first) == signature_digest(signature(3, "first", "first"))
