"""Counts the passes of every loop of the compiled code, and stops a kernel that has used up its budget.

`install` must run before the first compiled module is imported: it replaces the project's one compiler decorator by one
that puts a call of `_pass` at the head of each loop.  The counter lies in one word of memory, so that counting is the
same in all functions and between calls.
"""

import ast
import ctypes
import inspect
import textwrap

import numba
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

LIMIT = 200_000_000
"""Passes after which a step counts as hung."""
_word = ctypes.c_int64(0)
_ADDRESS = ctypes.addressof(_word)


@intrinsic
def _pass(typing_context):
    """Add one to the counter; gives its value."""
    del typing_context

    def generate(context, builder, signature, arguments):
        del context, signature, arguments
        address = builder.inttoptr(cgutils.intp_t(_ADDRESS), ir.IntType(64).as_pointer())
        value = builder.add(builder.load(address), ir.IntType(64)(1))
        builder.store(value, address)
        return value

    return types.int64(), generate


class _Counter(ast.NodeTransformer):
    """Puts the call in."""

    def _loop(self, node):
        self.generic_visit(node)
        check = ast.parse(f"if _pass() > {LIMIT}:\n    raise OverflowError('step budget')").body
        node.body = check + node.body
        return node

    visit_For = _loop  # noqa: N815
    visit_While = _loop  # noqa: N815


def counting_jit(function):
    """As `mavfi.numerics.jit.kernel_jit`, counted and not cached."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    tree.body[0].decorator_list = []
    tree = ast.fix_missing_locations(_Counter().visit(tree))
    scope = function.__globals__
    scope["_pass"] = _pass
    exec(compile(tree, function.__code__.co_filename, "exec"), scope)
    return numba.njit(error_model="numpy", fastmath=False)(scope[function.__name__])


def install():
    """Count from now on."""
    from mavfi.numerics import jit

    jit.kernel_jit = counting_jit


def passes():
    """Passes since the last call; sets the counter to zero."""
    value = _word.value
    _word.value = 0
    return value
