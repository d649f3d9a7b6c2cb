"""Headers that compiled code borrows from Python for one call.

Numba makes an object that counts references to each array that is passed from Python, which takes 40 ns.  The caller
holds a header during the call, so that its address is enough.
"""

from typing import Any, cast

import llvmlite.binding
import numba
import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import NativeValue, intrinsic, models, register_model, unbox
from numba.np.arrayobj import populate_array

_NDARRAY, _LIST = "mavfi_numpy_ndarray", "mavfi_python_list"
_TYPE, _DATA, _DIMENSIONS, _SHAPE, _STRIDES = 1, 2, 3, 4, 5
"""Places of words in NumPy's `PyArrayObject_fields`, in its stable C interface; `_DIMENSIONS` is a 32-bit integer."""
_LENGTH, _ITEMS = 2, 3
"""Places of words in Python's `PyListObject`, in its C interface."""
_BYTE, _WORD = ir.IntType(8), ir.IntType(64)
_type_of: Any = numba.typeof
_model, _unbox = cast(Any, register_model), cast(Any, unbox)
llvmlite.binding.add_symbol(_NDARRAY, id(np.ndarray))
llvmlite.binding.add_symbol(_LIST, id(list))


class Lent(types.Type):
    """Type of a parameter in compiled code: a header, of which the address is passed.

    Args:
        array: Type of the header, a contiguous array of one record.
        listed: Whether a list is passed, whose last item is the header, or a longer one that begins like it.
    """

    def __init__(self, array: types.Array, listed: bool) -> None:
        self.array, self.size, self.listed = array, cast(Any, array.dtype).size, listed
        super().__init__(name=f"Lent({array}, {listed})")


@_model(Lent)
class _LentModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Lent) -> None:  # noqa: ANN401 - Numba's
        super().__init__(dmm, fe_type, _BYTE.as_pointer())  # type: ignore[no-untyped-call]


@_unbox(Lent)
def _address_of(typ: Lent, obj: Any, c: Any) -> NativeValue:  # noqa: ANN401 - Numba's
    """The address of a header's record; a TypeError unless it is an array of one record of this size."""
    builder, narrow = c.builder, ir.IntType(32)
    error = cgutils.alloca_once_value(builder, cgutils.true_bit)  # type: ignore[no-untyped-call]
    data = cgutils.alloca_once_value(builder, cgutils.get_null_value(_BYTE.as_pointer()))  # type: ignore[no-untyped-call]

    def word(address: Any, place: Any) -> Any:  # noqa: ANN401
        words = builder.bitcast(address, _WORD.as_pointer())
        return builder.load(builder.gep(words, [place if isinstance(place, ir.Value) else ir.Constant(narrow, place)]))

    def pointer(address: Any, place: Any) -> Any:  # noqa: ANN401
        return builder.inttoptr(word(address, place), _BYTE.as_pointer())

    def if_of(address: Any, kind: str) -> Any:  # noqa: ANN401
        module = builder.module
        known = module.globals.get(kind) or cgutils.add_global_variable(module, _BYTE, kind)  # type: ignore[no-untyped-call]
        return if_equal(word(address, _TYPE), builder.ptrtoint(known, _WORD))

    def if_equal(found: Any, expected: Any, how: str = "==") -> Any:  # noqa: ANN401
        return builder.if_then(builder.icmp_unsigned(how, found, expected), likely=True)

    def read(header: Any) -> None:  # noqa: ANN401
        with (
            if_of(header, _NDARRAY),
            if_equal(builder.trunc(word(header, _DIMENSIONS), narrow), ir.Constant(narrow, 1)),
        ):
            shape, strides = (word(pointer(header, place), 0) for place in (_SHAPE, _STRIDES))
            fits = ">=" if typ.listed else "=="
            with if_equal(shape, ir.Constant(_WORD, 1)), if_equal(strides, ir.Constant(_WORD, typ.size), fits):
                builder.store(cgutils.false_bit, error)
                builder.store(pointer(header, _DATA), data)

    if typ.listed:
        with if_of(obj, _LIST):
            last = builder.sub(word(obj, _LENGTH), ir.Constant(_WORD, 1))
            with builder.if_then(builder.icmp_signed(">=", last, ir.Constant(_WORD, 0)), likely=True):
                read(pointer(pointer(obj, _ITEMS), last))
    else:
        read(obj)
    with builder.if_then(builder.load(error), likely=False):
        c.pyapi.err_set_string("PyExc_TypeError", f"header: not an array of one record of {typ.size} bytes")
    return NativeValue(builder.load(data), is_error=builder.load(error))  # type: ignore[no-untyped-call]


def _array(found: types.Array, length: int, width: int, context: Any, builder: Any, address: Any) -> Any:  # noqa: ANN401
    """An array at an address, without references to Python objects."""
    made = context.make_array(found)(context, builder)
    shape, itemsize = (context.get_constant(types.intp, number) for number in (length, width))
    data = builder.bitcast(address, made.data.type)
    populate_array(made, data=data, shape=[shape], strides=[itemsize], itemsize=itemsize, meminfo=None)  # type: ignore[no-untyped-call]
    return made._getvalue()


def _header(typingctx: Any, lent: Any) -> Any:  # noqa: ANN401
    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ANN401
        return _array(lent.array, 1, lent.size, context, builder, arguments[0])

    return lent.array(lent), codegen


def _content(typingctx: Any, lent: Any) -> Any:  # noqa: ANN401
    found = types.Array(types.uint8, 1, "C")

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ANN401
        return _array(found, lent.size, 1, context, builder, arguments[0])

    return found(lent), codegen


header_of: Any = intrinsic(_header)
"""In compiled code: the header itself, of the same type as a header from Python."""
content_of: Any = intrinsic(_content)
"""In compiled code: the bytes of a header, shape (size,), uint8, of the same type as bytes from Python."""


def lent(header: np.ndarray, *, listed: bool = False) -> Lent:
    """Type of headers like this one, shape (1,), or of lists (see `Lent`), for `numerics.jit.entry`."""
    return Lent(_type_of(header), listed)
