"""What the machine code of a compiled function depends on, as a digest: the key of the cache of compiled code.

It covers the bytecode with its constants, the values that the function takes from its module and from enclosing
functions, and those of every compiled function that it calls.  Comments, docstrings, layout, line numbers, and the
names of files and modules are not in it: to change them recompiles nothing elsewhere.
"""

import dis
import functools
import hashlib
import sys
import types as python
import weakref
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numba.core import types

_PACKAGES = ("numerics", "kernels", "sim", "detectors", "extras")
"""Packages of mavfi with compiled functions."""
_VERSIONED = frozenset({"builtins", "cmath", "math", "numba", "numpy", "operator"})
"""Packages whose content follows from the versions, which every key of compiled code contains."""
_PLAIN = (bool, int, float, complex, str, bytes, np.generic, np.dtype, python.NoneType, python.EllipsisType)
_READ_FIRST_CONSTANT = (dis.opmap["LOAD_CONST"], 0)
"""Instruction that reads the constant in whose place a docstring is."""


class UnknownDependencyError(Exception):
    """A function uses a value of which nothing tells whether it has changed: its code cannot be kept."""


@dataclass(frozen=True, slots=True)
class _Body:
    """A compiled function without its callees.

    Attributes:
        values: What it took from its surroundings when the digest was made, by name.
        digest: SHA-256 of its code and of the values that are no compiled functions.
        callees: The compiled functions among the values, in order.
    """

    values: dict[str, Any]
    digest: bytes
    callees: tuple[Any, ...]


_bodies: "weakref.WeakKeyDictionary[Any, _Body]" = weakref.WeakKeyDictionary()


def content_digest(dispatcher: Any) -> bytes:
    """SHA-256 of a compiled function and of all that it calls.

    Raises:
        UnknownDependencyError: One of them uses a value of an unknown kind.
    """
    digest = hashlib.sha256()
    numbers: dict[int, int] = {}  # order of visits, by identity of the dispatcher
    waiting = [dispatcher]
    while waiting:
        current = waiting.pop()
        if id(current) in numbers:
            digest.update(f"as function {numbers[id(current)]}".encode())
            continue
        numbers[id(current)] = len(numbers)
        body = _body_of(current)
        digest.update(body.digest)
        waiting.extend(reversed(body.callees))
    return digest.digest()


def signature_digest(signature: tuple[Any, ...]) -> bytes:
    """SHA-256 of the Numba types of arguments, with the names of the fields of named tuples."""
    content = _Content()
    for kind in signature:
        content.numba_type(kind)
    return content.digest.digest()


def code_digest(*functions: Any) -> bytes:
    """SHA-256 of the code of plain Python functions, without what they call."""
    content = _Content()
    for function in functions:
        content.code(function.__code__, function.__doc__)
    return content.digest.digest()


@functools.cache
def packages_digest() -> str:
    """Digest of the text of all modules with compiled functions."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for name in _PACKAGES:
        for path in sorted((package / name).rglob("*.py")):
            digest.update(path.relative_to(package).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def _body_of(dispatcher: Any) -> _Body:
    """The body, made again if a value in its surroundings has been replaced."""
    function = dispatcher.py_func
    values = _surroundings(function)
    previous = _bodies.get(dispatcher)
    if previous is not None and previous.values.keys() == values.keys():
        if all(values[name] is value for name, value in previous.values.items()):
            return previous
    content = _Content()
    content.text(type(dispatcher).__name__, sorted(dispatcher.targetoptions.items()), sorted(dispatcher.locals.items()))
    content.code(function.__code__, function.__doc__)
    content.value(function.__defaults__)
    content.value(tuple(sorted((function.__kwdefaults__ or {}).items())))
    for name, value in values.items():
        content.text(name)
        content.value(value)
    body = _Body(values, content.digest.digest(), tuple(content.callees))
    _bodies[dispatcher] = body
    return body


def _surroundings(function: Any) -> dict[str, Any]:
    """Values that a function takes from enclosing functions, from its module, and from modules named there."""
    names = set(_names(function.__code__))
    values = dict(_named_in(function.__globals__, names, ""))
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        try:
            values[name] = cell.cell_contents
        except ValueError:
            raise UnknownDependencyError(f"{function.__qualname__}: {name} has no value yet") from None
    return dict(sorted(values.items()))


def _names(code: python.CodeType) -> Iterator[str]:
    """Names of globals and attributes in a code object, and in those of its comprehensions and inner functions."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, python.CodeType):
            yield from _names(constant)


def _named_in(namespace: Mapping[str, Any], names: set[str], prefix: str) -> Iterator[tuple[str, Any]]:
    """Values with some names in a module, and with the same names in the modules among them."""
    for name in names & namespace.keys():
        value = namespace[name]
        yield prefix + name, value
        if isinstance(value, python.ModuleType) and not _is_versioned(value.__name__) and prefix.count(".") < 4:
            yield from _named_in(vars(value), names, f"{prefix}{name}.")


def _is_versioned(module: str | None) -> bool:
    return (module or "").partition(".")[0] in _VERSIONED


class _Content:
    """Collects the digest of values, and the compiled functions among them."""

    def __init__(self) -> None:
        self.digest = hashlib.sha256()
        self.callees: list[Any] = []

    def text(self, *parts: object) -> None:
        """Add the text of plain data; its length keeps neighbours apart."""
        text = repr(parts).encode()
        self.digest.update(len(text).to_bytes(8, "little") + text)

    def code(self, code: python.CodeType, docstring: str | None = None) -> None:
        """Add bytecode and constants, without the docstring."""
        self.text(
            code.co_code.hex(),
            code.co_exceptiontable.hex(),
            code.co_flags,
            code.co_names,
            code.co_varnames,
            code.co_freevars,
            code.co_cellvars,
            code.co_argcount,
            code.co_kwonlyargcount,
        )
        instructions = zip(code.co_code[::2], code.co_code[1::2], strict=True)
        reads_first = _READ_FIRST_CONSTANT in instructions
        for number, constant in enumerate(code.co_consts):
            if number == 0 and constant == docstring and not reads_first:
                self.text("docstring")
            elif isinstance(constant, python.CodeType):
                self.code(constant)
            else:
                self.value(constant)

    def value(self, value: Any) -> None:
        """Add a value from the surroundings of a function."""
        if isinstance(value, _PLAIN):
            self.text(type(value).__qualname__, value)
        elif isinstance(value, tuple | list):
            self.text(type(value).__qualname__, getattr(value, "_fields", ()), len(value))
            for item in value:
                self.value(item)
        elif isinstance(value, frozenset):
            self.text("frozenset", sorted(map(repr, value)))
        elif isinstance(value, np.ndarray):
            self.text("array", value.dtype, value.shape, value.strides)
            self.digest.update(value.tobytes())
        else:
            self._named(value)

    def _named(self, value: Any) -> None:
        """Add a function, class, module or type."""
        if hasattr(value, "py_func"):
            self.text("compiled function")
            self.callees.append(value)
        elif isinstance(value, types.Type):
            self.numba_type(value)
        elif isinstance(value, type):
            self._class(value)
        elif isinstance(value, python.ModuleType):
            self.text("module")
        elif hasattr(value, "_defn"):
            self.text("intrinsic", value.__qualname__)
            self._source(value.__module__)
        elif _is_versioned(getattr(value, "__module__", None)) and isinstance(getattr(value, "__name__", None), str):
            self.text(value.__module__, value.__name__)
        elif isinstance(value, python.FunctionType):
            self._plain_function(value)
        else:
            raise UnknownDependencyError(repr(value))

    def numba_type(self, kind: types.Type) -> None:
        """Add a type; its text lacks the names of the fields of named tuples."""
        if isinstance(kind, types.ExternalFunction):
            self.text(kind.symbol, str(kind.sig))
            return
        if isinstance(kind, types.Callable):
            raise UnknownDependencyError(str(kind))
        self.text(str(kind))
        if not _is_versioned(type(kind).__module__):
            self._source(type(kind).__module__)
        parts = kind.key if isinstance(kind.key, tuple) else (kind.key,)
        for part in parts:
            members = part if isinstance(part, tuple) else (part,)
            for member in members:
                if isinstance(member, types.Type) and member is not kind:
                    self.numba_type(member)
                elif isinstance(member, type):
                    self._class(member)

    def _class(self, value: type) -> None:
        if _is_versioned(value.__module__):
            self.text(value.__module__, value.__qualname__)
            return
        fields = getattr(value, "_fields", None)
        self.text(value.__qualname__, fields)
        if fields is None:
            self._source(value.__module__)
        else:
            self.value(tuple(sorted(getattr(value, "_field_defaults", {}).items())))

    def _plain_function(self, value: python.FunctionType) -> None:
        """Add a function that has an `overload`, which may call any of mavfi's: the text of its module, and theirs."""
        self.text("plain function", value.__qualname__)
        self._source(value.__module__)
        self.text(packages_digest())

    def _source(self, module: str) -> None:
        """Add the text of a module."""
        self.text(_text_digest(module))


@functools.cache
def _text_digest(module: str) -> str:
    file = getattr(sys.modules.get(module), "__file__", None)
    if file is None:
        raise UnknownDependencyError(f"module {module} has no file")
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()
