"""What shows a flight of `mavfi fly` while it runs: observers that extras add, with options of their own."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mavfi.cli.console import check_number, console
from mavfi.errors import BadInputError
from mavfi.plugins import extensions

if TYPE_CHECKING:
    from mavfi.flight.loop import ObserverListener

OBSERVERS = "mavfi.observers"
"""Group of entry points, by the name of an option: objects with `options`, see `with_extra_options`, `chosen(values)`
(whether they are set; refuses values that are not allowed), and `build(values)` (an observer and a line of text).
"""
REAL_TIME = 1.0
Pace = Annotated[
    float, typer.Option(help="Flight time per wall time with --live and --mavlink; 0 = as fast as possible.")
]


def chosen_observers(values: Mapping[str, Any], pace: float, fault: str | None) -> list[Any]:
    """The observers whose options are set; refuses values that are not allowed, before the flight."""
    observers = extensions(OBSERVERS)
    chosen = {name: observer for name, observer in observers.items() if observer.chosen(values)}
    check_number("--pace", pace, 0, 1000)
    if pace != REAL_TIME and not chosen:
        options = " or ".join(f"--{name}" for name in observers)
        raise BadInputError(f"--pace: {pace:g}: nothing shows the flight; allowed: together with {options}")
    if chosen and (fault or "").startswith("instruction"):
        raise BadInputError(
            f"--{next(iter(chosen))}: faults in instructions fly in a forked process; allowed: null, state, memory, "
            "sensor"
        )
    return list(chosen.values())


@contextmanager
def observing(chosen: list[Any], values: Mapping[str, Any], pace: float) -> Iterator[tuple[ObserverListener, ...]]:
    """Observers of a flight, for `ArmSetup.observers`, until the end of the context."""
    if not chosen:
        yield ()
        return
    from mavfi.flight.loop import ObserverListener

    attached: list[ObserverListener] = []
    with ExitStack() as stack:
        for observer in chosen:
            view, text = observer.build(values)
            stack.callback(view.close)
            console(error=True).print(text, markup=False, highlight=False)
            attached.append(ObserverListener(view, pace))
            pace = 0.0  # only the first waits for the pace
        yield tuple(attached)
