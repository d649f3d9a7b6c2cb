"""Options of `mavfi fly` that show a flight while it runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mavfi.cli.console import check_number, console
from mavfi.errors import BadInputError

if TYPE_CHECKING:
    from mavfi.extras.logs.live import LiveView
    from mavfi.extras.mavlink.running import Telemetry

_LAST_PORT = 65_535
REAL_TIME = 1.0
Live = Annotated[bool, typer.Option("--live", help="Serve the running flight to Foxglove and Lichtblick (extra live).")]
Mavlink = Annotated[
    int | None, typer.Option(metavar="PORT", help="Send the flight to a ground station's UDP port on loopback: 14550.")
]
Pace = Annotated[
    float, typer.Option(help="Flight time per wall time with --live and --mavlink; 0 = as fast as possible.")
]


def check_options(live: bool, mavlink: int | None, pace: float, fault: str | None) -> None:
    """Refuse values of these options that are not allowed, before the flight."""
    check_number("--mavlink", mavlink, 1, _LAST_PORT)
    check_number("--pace", pace, 0, 1000)
    if pace != REAL_TIME and not live and mavlink is None:
        raise BadInputError(f"--pace: {pace:g}: nothing shows the flight; allowed: together with --live or --mavlink")
    if (live or mavlink is not None) and (fault or "").startswith("instruction"):
        option = "--live" if live else "--mavlink"
        raise BadInputError(
            f"{option}: faults in instructions fly in a forked process; allowed: null, state, memory, sensor"
        )


@contextmanager
def observing(live: bool, mavlink: int | None, pace: float) -> Iterator[tuple[Callable[[Any], None], ...]]:
    """Observers of a flight, for `ArmSetup.observers`, until the end of the context."""
    if not live and mavlink is None:
        yield ()
        return
    from mavfi.flight.loop import Attached

    views = list(_views(live, mavlink))
    try:
        # only the first waits for the pace
        yield tuple(Attached(view, pace if place == 0 else 0.0) for place, view in enumerate(views))
    finally:
        for view in views:
            view.close()


def _views(live: bool, mavlink: int | None) -> Iterator[LiveView | Telemetry]:
    out = console(error=True)
    if live:
        from mavfi.extras.logs.live import PORT, LiveView

        view = LiveView(PORT)
        out.print(f"serving the flight at {view.address}", markup=False, highlight=False)
        yield view
    if mavlink is not None:
        from mavfi.extras.mavlink.running import HOST, Telemetry

        out.print(f"sending the flight to udp://{HOST}:{mavlink}", markup=False, highlight=False)
        yield Telemetry(mavlink)
