"""Arguments of compiled functions that are unpacked once, and then passed as one address.

Numba unpacks each array that is passed from Python in 30 to 60 ns, which for a short function with a dozen tables takes
longer than the function.
"""

from typing import Any, cast

import numba
import numpy as np
from numba.core import cgutils, types
from numba.core.registry import cpu_target
from numba.extending import intrinsic

from mavfi.numerics.jit import is_compiled, kernel_jit


def _load(typingctx: Any, address: Any, kind: Any) -> Any:  # noqa: ANN401 - Numba's types
    loaded = kind.instance_type

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ANN401
        pointer = builder.inttoptr(arguments[0], context.get_data_type(loaded).as_pointer())
        return context.unpack_value(builder, loaded, pointer)

    return loaded(types.int64, kind), codegen


def _put_at(typingctx: Any, values: Any, address: Any) -> Any:  # noqa: ANN401
    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ANN401
        pointer = builder.inttoptr(arguments[1], context.get_data_type(values).as_pointer())
        context.pack_value(builder, values, _borrowed(context, builder, values, arguments[0]), pointer)
        return context.get_dummy_value()

    return types.void(values, types.int64), codegen


load: Any = intrinsic(_load)
"""In compiled code, `load(address, kind)`: the values at an address, see `Stored`; `kind` is their `kind_of`."""
_store: Any = intrinsic(_put_at)


def _borrowed(context: Any, builder: Any, kind: Any, value: Any) -> Any:  # noqa: ANN401
    """A value without references to Python objects: compiled code does not count references to its arrays."""
    if isinstance(kind, types.BaseTuple):
        for index, part_kind in enumerate(cast(Any, kind).types):
            part = _borrowed(context, builder, part_kind, builder.extract_value(value, index))
            value = builder.insert_value(value, part, index)
    elif isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value)
        array.meminfo = cgutils.get_null_value(array.meminfo.type)  # type: ignore[no-untyped-call]
        array.parent = cgutils.get_null_value(array.parent.type)  # type: ignore[no-untyped-call]
        value = array._getvalue()
    return value


@kernel_jit
def _put(values: Any, address: int) -> None:  # noqa: ANN401
    _store(values, address)


_type_of: Any = numba.typeof


def kind_of(*values: Any) -> Any:  # noqa: ANN401
    """Type of stored values, from examples."""
    return _type_of(values)


class Stored:
    """Values for compiled functions, kept alive as long as this object.

    Args:
        kind: `kind_of` examples of them.
        values: Arrays, tuples of arrays, and numbers.

    Attributes:
        values: The values.
        address: Where compiled code finds them; valid in this process.

    Raises:
        TypeError: The values are not of this kind.
    """

    def __init__(self, kind: Any, *values: Any) -> None:  # noqa: ANN401
        self.values, self.address = values, 0
        actual = _type_of(values)
        if actual != kind:
            raise TypeError(f"stored values: {actual}; allowed: {kind}")
        if is_compiled(_put):
            context: Any = cpu_target.target_context
            self._content = np.zeros(context.get_abi_sizeof(context.get_data_type(kind)), np.uint8)
            self.address = int(self._content.ctypes.data)
            _put(values, self.address)
