"""Saves what objects remember, puts it back, and compares it: for kernels, detectors and the host itself.

All attributes of an object are its memory but those that its class names in `not_memory`: so what is forgotten there
costs time, never bits.  Containers and arrays are copied, and what two places share they share again after `restore`.
Published states, frozen dataclasses and configurations never change and are kept as they are.  An object with `save`,
`restore` and `same` of its own is asked to do it.
"""

import copy
import dataclasses
import hashlib
import struct
from enum import Enum
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np
from pydantic import BaseModel

from mavfi.states import State

_AS_THEY_ARE = (
    type(None), bool, int, float, complex, str, bytes, Enum, type, State, BaseModel, FunctionType, MethodType,
    BuiltinFunctionType, ModuleType, np.generic, np.dtype,
)  # fmt: skip


class _Saved:
    """The memory of an object: the object itself, and what its attributes were."""

    __slots__ = ("content", "target")

    def __init__(self, target: Any, content: Any) -> None:  # noqa: ANN401
        self.target, self.content = target, content


_KINDS: dict[type, str] = {}
"""What is done with values of a type."""


def _kind(value: Any) -> str:  # noqa: ANN401
    kind = type(value)
    known = _KINDS.get(kind)
    if known is None:
        known = _KINDS[kind] = _kind_of(kind, value)
    return known


def _kind_of(kind: type, value: Any) -> str:  # noqa: ANN401, PLR0911 (one line for each)
    parameters = getattr(kind, "__dataclass_params__", None)
    if issubclass(kind, _AS_THEY_ARE) or (parameters is not None and parameters.frozen):
        return "same"
    if issubclass(kind, np.ndarray):
        return "array"
    if issubclass(kind, tuple):
        return "tuple"
    if kind in (list, dict):
        return kind.__name__
    if all(callable(getattr(kind, name, None)) for name in ("save", "restore", "same")):
        return "own"
    if hasattr(value, "__dict__") or dataclasses.is_dataclass(kind):
        return "object"
    return "other"


def _names(value: Any) -> list[str]:  # noqa: ANN401
    """Attributes that are memory."""
    kind = type(value)
    if hasattr(value, "__dict__"):
        names = list(vars(value))
    else:
        names = [field.name for field in dataclasses.fields(value)]
    apart = getattr(kind, "not_memory", ())
    return [name for name in names if name not in apart] if apart else names


def save(value: Any, memo: dict[int, Any] | None = None) -> Any:  # noqa: ANN401
    """What a value is now, in a form that later changes of it do not reach.

    Args:
        value: Anything.
        memo: What is saved already, by identity; None = nothing.
    """
    memo = {} if memo is None else memo
    kind = _kind(value)
    if kind == "same":
        return value
    known = memo.get(id(value))
    if known is None:
        known = memo[id(value)] = _saved(value, kind, memo)
    return known


def _saved(value: Any, kind: str, memo: dict[int, Any]) -> Any:  # noqa: ANN401, PLR0911
    if kind == "array":
        return value.copy()
    if kind == "tuple":
        items = [save(item, memo) for item in value]
        if all(mine is theirs for mine, theirs in zip(items, value, strict=True)):
            return value
        return _tuple(value, items)
    if kind == "list":
        return [save(item, memo) for item in value]
    if kind == "dict":
        return {key: save(item, memo) for key, item in value.items()}
    if kind == "own":
        return _Saved(value, value.save())
    if kind == "object":
        return _Saved(value, [(name, save(getattr(value, name), memo)) for name in _names(value)])
    return copy.deepcopy(value)


def _tuple(like: Any, items: list[Any]) -> Any:  # noqa: ANN401
    return type(like)(*items) if hasattr(like, "_fields") else tuple(items)


def restored(saved: Any, memo: dict[int, Any] | None = None) -> Any:  # noqa: ANN401
    """The value that was saved; objects are the same objects, put back; arrays and containers are new ones.

    Args:
        saved: What `save` gave; it can be restored again.
        memo: What is restored already, by identity; None = nothing.
    """
    memo = {} if memo is None else memo
    if type(saved) is not _Saved and _kind(saved) == "same":
        return saved
    known = memo.get(id(saved))
    if known is None:
        known = memo[id(saved)] = _restored(saved, memo)
    return known


def _restored(saved: Any, memo: dict[int, Any]) -> Any:  # noqa: ANN401
    if type(saved) is _Saved:
        target, content = saved.target, saved.content
        if _kind(target) == "own":
            target.restore(content)
        else:
            for name, value in content:
                setattr(target, name, restored(value, memo))
        return target
    kind = _kind(saved)
    if kind == "array":
        return saved.copy()
    if kind == "tuple":
        return _tuple(saved, [restored(item, memo) for item in saved])
    if kind == "list":
        return [restored(item, memo) for item in saved]
    if kind == "dict":
        return {key: restored(item, memo) for key, item in saved.items()}
    return copy.deepcopy(saved)


def same(value: Any, saved: Any) -> bool:  # noqa: ANN401
    """Whether `save` of a value would give the same, bit for bit (NaN equals the same NaN, 0.0 is not -0.0).

    Args:
        value: What is there now.
        saved: What `save` gave at another time.
    """
    if value is saved:
        return True
    if type(saved) is _Saved:
        return _same_object(value, saved)
    if type(value) is not type(saved):
        return False
    if isinstance(value, (list, tuple)):
        return len(value) == len(saved) and all(map(same, value, saved))
    if isinstance(value, dict):
        return list(value) == list(saved) and all(same(item, saved[key]) for key, item in value.items())
    return _same_bits(value, saved)


def _same_bits(value: Any, saved: Any) -> bool:  # noqa: ANN401
    if isinstance(value, State):
        return bool(value.spec is saved.spec and value.same_bits(saved))
    if isinstance(value, np.ndarray):
        alike = value.shape == saved.shape and value.dtype == saved.dtype
        return alike and bool(value.tobytes() == saved.tobytes())
    if isinstance(value, float):
        return struct.pack("d", value) == struct.pack("d", saved)
    if dataclasses.is_dataclass(value):
        return all(same(getattr(value, f.name), getattr(saved, f.name)) for f in dataclasses.fields(value))
    if _kind(value) == "object":
        return same(vars(value), vars(saved))
    return bool(value == saved)


def _same_object(value: Any, saved: _Saved) -> bool:  # noqa: ANN401
    if type(value) is not type(saved.target):
        return False
    if _kind(value) == "own":
        return bool(value.same(saved.content))
    names = _names(value)
    return names == [name for name, _ in saved.content] and all(
        same(getattr(value, name), content) for name, content in saved.content
    )


def fingerprint(value: Any) -> bytes:  # noqa: ANN401
    """A digest of what `save` would give: the same in any process, and different wherever `same` says no.

    Configurations and functions, which never change, are left out.
    """
    total = hashlib.sha256()
    _feed(total, value)
    return total.digest()


def _feed(total: "hashlib._Hash", value: Any) -> None:  # noqa: ANN401
    if type(value) is _Saved:
        _feed(total, value.content)
        return
    kind = _kind(value)
    total.update(type(value).__name__.encode())
    if isinstance(value, np.ndarray):
        total.update(f"{value.dtype.str}{value.shape}".encode())
        total.update(value.tobytes())
    elif kind == "same":
        total.update(_leaf(value))
    elif isinstance(value, (tuple, list, dict)):
        total.update(str(len(value)).encode())
        for item in value.items() if isinstance(value, dict) else value:
            _feed(total, item)
    elif kind == "own":
        _feed(total, value.save())
    elif kind == "object":
        for name in _names(value):
            total.update(name.encode())
            _feed(total, getattr(value, name))


def _leaf(value: Any) -> bytes:  # noqa: ANN401
    """Bytes of a value that is kept as it is."""
    if isinstance(value, State):
        return value.spec.name.encode() + value.header.tobytes() + b"|" + value.elements.tobytes()
    if isinstance(value, float):
        return struct.pack("d", value)
    return repr(value).encode() if isinstance(value, (type(None), int, str, bytes, Enum, np.generic)) else b""
