"""The page of the demo: pictures and sentences, and the flights in three dimensions when they are asked for."""

import base64
import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from PIL import Image

from mavfi.extras.demo.faults import FlownDemo, headline
from mavfi.report.html.flight_page import FlightPage, page_of_result
from mavfi.report.html.page import write

_TEMPLATES = Path(__file__).parent
_DOTS_PER_INCH = 90
_COLOURS = 64
"""Number of colours of a picture: it has flat areas and lines, and takes a third of the space of the full range.

The median cut leaves the colours of large areas as they are, so that obstacles look alike in all pictures.
"""


def picture_of(flown: FlownDemo) -> bytes:
    """The picture of the flights of a fault, as a small PNG file."""
    drawn = io.BytesIO()
    flown.result.plot().savefig(drawn, format="png", dpi=_DOTS_PER_INCH)
    small = io.BytesIO()
    image = Image.open(drawn).convert("RGB").quantize(_COLOURS, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    image.save(small, format="png", optimize=True)
    return small.getvalue()


def _flight_page(flown: FlownDemo) -> FlightPage:
    """The flights of a fault as on the page of `mavfi fly --html`."""
    flown_as = flown.result.flown_as
    assert flown_as is not None  # all faults are those of the host `local`
    return page_of_result(flown.result, flown_as.setup, flown_as.without_detector, flown.demo.command)


def _entry(flown: FlownDemo) -> dict[str, Any]:
    """A fault as the template of the page needs it."""
    return {
        "number": flown.number,
        "title": flown.demo.title,
        "sentence": flown.sentence,
        "is_lost": flown.is_lost,
        "picture": base64.b64encode(picture_of(flown)).decode(),
        "flight": _flight_page(flown).to_json(),
    }


def write_demo_page(
    path: Path, demos: Sequence[FlownDemo], show: Callable[[int, int], None] = lambda _done, _total: None
) -> None:
    """Write the page; the flights are repeated to record what it shows.

    Args:
        path: The file.
        demos: The faults, in order.
        show: Shows how many faults are recorded, and of how many.

    Raises:
        BadInputError: The file cannot be written.
    """
    entries: list[dict[str, Any]] = []
    for flown in demos:
        show(len(entries), len(demos))
        entries.append(_entry(flown))
    show(len(entries), len(demos))
    write(path, "demo.html.j2", _TEMPLATES, headline=headline(demos), entries=entries)
