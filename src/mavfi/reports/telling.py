"""The picture of the run of a campaign that says most, and its caption."""

from pathlib import Path

from mavfi.campaign.telling import Telling
from mavfi.reports.picture import draw_flight
from mavfi.reports.text import signed_percent


def draw(telling: Telling, path: Path) -> str:
    """Draw the run: golden, with the fault, and with the detector.

    Args:
        telling: The run, flown again.
        path: File to write.

    Returns:
        What the picture shows.

    Raises:
        BadInputError: The file cannot be written.
    """
    detector = "" if telling.saved is None else str(telling.saved["arm"])
    draw_flight(path, telling.flight, telling.golden, telling.recovered, detector=detector)
    return _caption(telling)


def _caption(telling: Telling) -> str:
    row, injection = telling.injected, telling.flight.log.injections[0]
    change = "" if row["inflation"] is None else f" ({signed_percent(row['inflation'])} flight time)"
    bit = "" if injection.bit is None else f", bit {injection.bit}"
    text = f"`{row['run_id']}`: {injection.site}{bit}, at {injection.time_s:.2f} s; "
    text += f"ends in {row['status'].replace('_', ' ')}{change}."
    if telling.saved is not None:
        text += f" With {telling.saved['arm']} on it reaches the goal."
    return f"{text} See `mavfi explain`."
