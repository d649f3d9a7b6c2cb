"""How figures look: one palette that the colour-blind can tell apart, one typography."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

from mavfi.errors import BadInputError

BLUE, ORANGE, GREEN, PURPLE, SKY, AMBER = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00"
"""Of Okabe and Ito's palette."""
INK, GREY, PALE = "#222222", "#777777", "#DDDDDD"
DOTS_PER_INCH = 160

_SETTINGS: Any = {
    "font.size": 9.5,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelcolor": INK,
    "axes.edgecolor": GREY,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "text.color": INK,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "grid.color": PALE,
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "lines.solid_capstyle": "round",
    "figure.facecolor": "white",
    "svg.hashsalt": "mavfi",
}
_ARMS = (GREEN, AMBER, PURPLE, SKY)


@contextmanager
def house_style() -> Iterator[None]:
    """Figures made inside look alike; settings of a caller's own figures are left alone."""
    with rc_context(_SETTINGS):
        yield


def setting_colours(settings: list[str]) -> dict[str, str]:
    """Colour of each setting: golden blue, faults orange, then one for each detector's arm."""
    colours: dict[str, str] = {}
    arms = [setting for setting in settings if not setting.startswith("golden") and setting != "fi"]
    for setting in settings:
        if setting in arms:
            colours[setting] = _ARMS[arms.index(setting) % len(_ARMS)]
        else:
            colours[setting] = ORANGE if setting == "fi" else BLUE
    return colours


def write(figure: Figure, path: Path) -> Path:
    """Write a figure in the format that the ending of the file says.

    Raises:
        BadInputError: The place cannot be written.
    """
    try:
        figure.savefig(path, dpi=DOTS_PER_INCH)
    except OSError as error:
        raise BadInputError(f"{path}: cannot be written ({error.strerror})") from None
    return path
