"""Compiled functions whose calls are counted in the record of a flight: faults in instructions address calls."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from mavfi.flight.loop import Loop


class CallResult(NamedTuple):
    """A call that was made by somebody else, with its result."""

    result: Any


Intercept = Callable[[str, int, Callable[..., Any], tuple[Any, ...]], CallResult | None]
"""Called before each call with name, number of the call, function and arguments; None = the call is made as usual."""


class CountedFunction:
    """A compiled function, called in its place.

    Calls that repeat others for verification are not counted: faults address calls of first executions, as in flights
    without a detector.

    Attributes:
        intercept: May take calls over; None = no call is.
    """

    def __init__(self, name: str, function: Callable[..., Any]) -> None:
        self.intercept: Intercept | None = None
        self._name = name
        self._function = function
        self._loop: Loop | None = None

    def attach(self, loop: Loop) -> None:
        """Count calls in the record of a loop."""
        self._loop = loop
        loop.record.calls[self._name] = 0

    @contextmanager
    def replaced(self, function: Callable[..., Any]) -> Iterator[None]:
        """Call another function, which returns the same."""
        original = self._function
        self._function = function
        try:
            yield
        finally:
            self._function = original

    def __call__(self, *args: Any) -> Any:
        """Call the function."""
        loop = self._loop
        if loop is None or loop.repeating:
            return self._function(*args)
        call = loop.record.calls[self._name]
        loop.record.calls[self._name] = call + 1
        if self.intercept is not None:
            intercepted = self.intercept(self._name, call, self._function, args)
            if intercepted is not None:
                return intercepted.result
        return self._function(*args)
