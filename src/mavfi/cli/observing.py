"""What shows a flight of `mavfi fly` while it runs: observers that extras add, with options of their own."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Annotated, Any, Protocol

import typer

from mavfi.cli.console import check_number, console
from mavfi.errors import BadInputError
from mavfi.plugins import extensions

if TYPE_CHECKING:
    from mavfi.flight.observers import ObserverListener

OBSERVERS = "mavfi.observers"
"""Group of entry points: a `FlightObserver` by the name of its option."""
REAL_TIME = 1.0
Pace = Annotated[
    float, typer.Option(help="Flight time per wall time with --live and --mavlink; 0 = as fast as possible.")
]


class FlightObserver(Protocol):
    """What an extra adds to `mavfi fly`."""

    options: Mapping[str, Any]
    """Annotated types of its options by name, see `with_extra_options`."""

    def chosen(self, values: Mapping[str, Any]) -> bool:
        """Whether its options are set; refuses values that are not allowed."""

    def build(self, values: Mapping[str, Any]) -> tuple[Any, str]:
        """An observer with `close`, and a line of text that says where to look."""


def chosen_observers(values: Mapping[str, Any], pace: float, fault: str | None) -> list[FlightObserver]:
    """The observers whose options are set; refuses values that are not allowed, before the flight."""
    from mavfi.faults.combined import levels_in

    observers = extensions(OBSERVERS)
    chosen = {name: observer for name, observer in observers.items() if observer.chosen(values)}
    check_number("--pace", pace, 0, 1000)
    if pace != REAL_TIME and not chosen:
        options = " or ".join(f"--{name}" for name in observers)
        raise BadInputError(f"--pace: {pace:g}: nothing shows the flight; allowed: together with {options}")
    if chosen and "instruction" in levels_in(fault):
        raise BadInputError(
            f"--{next(iter(chosen))}: faults in instructions fly in a forked process; allowed: null, state, memory, "
            "sensor"
        )
    return list(chosen.values())


@contextmanager
def observing(
    chosen: list[FlightObserver], values: Mapping[str, Any], pace: float
) -> Iterator[tuple[ObserverListener, ...]]:
    """Observers of a flight, for `ArmSetup.observers`, until the end of the context."""
    if not chosen:
        yield ()
        return
    from mavfi.flight.observers import ObserverListener

    attached: list[ObserverListener] = []
    with ExitStack() as stack:
        for number, observer in enumerate(chosen):
            view, text = observer.build(values)
            stack.callback(view.close)
            console(error=True).print(text, markup=False, highlight=False)
            own_pace = pace if number == 0 else 0.0  # only the first waits for the wall clock
            attached.append(ObserverListener(view, own_pace))
        yield tuple(attached)
