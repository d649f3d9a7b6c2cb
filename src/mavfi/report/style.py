"""Common style of figures: a palette safe for colour-blind readers, and typography."""

from contextlib import AbstractContextManager
from itertools import cycle
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

from mavfi.errors import writing

BLUE, ORANGE, GREEN, PURPLE, SKY, AMBER = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00"
YELLOW = "#B8A800"
"""Colours of the Okabe–Ito palette, the last one darker."""
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
_ARMS = (
    (GREEN, "^", "--"), (PURPLE, "D", "-."), (AMBER, "v", ":"), (SKY, "P", (0, (1, 1))), (INK, "X", (0, (5, 1, 1, 1))),
    (GREY, "h", (0, (6, 2))), (YELLOW, "<", (0, (3, 1))),
)  # fmt: skip
"""Colour, marker and dashes of each arm, distinguishable in greyscale."""


def house_style() -> AbstractContextManager[None]:
    """Context in which figures use the common style; global settings of matplotlib are unchanged."""
    return rc_context(_SETTINGS)


def setting_looks(settings: list[str]) -> dict[str, dict[str, Any]]:
    """Colour and marker by setting: blue discs for golden runs, orange squares for faults, then one style per arm."""
    looks = {"golden": {"color": BLUE, "marker": "o"}, "fi": {"color": ORANGE, "marker": "s"}}
    arms = [setting for setting in settings if setting not in looks]
    for setting, (colour, marker, _) in zip(arms, cycle(_ARMS), strict=False):
        looks[setting] = {"color": colour, "marker": marker}
    return {setting: looks[setting] for setting in settings}


def curve(look: dict[str, Any], *, wide: bool) -> dict[str, Any]:
    """Colour, dashes and width of a setting's curve."""
    dashes = {colour: line for colour, _, line in _ARMS}
    return {"color": look["color"], "linestyle": dashes.get(look["color"], "-"), "linewidth": 2.8 if wide else 1.4}


def setting_label(setting: str) -> str:
    """Display name of a setting: "golden run", "fault", "fault + gaussian"."""
    kind, _, arm = setting.partition("_")
    words = {"golden": "golden run", "fi": "fault", "dr": "fault", "null": "null fault"}.get(kind, kind)
    return f"{words} + {arm}" if arm else words


def write(figure: Figure, path: Path) -> Path:
    """Write a figure in the format given by the file extension; `BadInputError` if the file cannot be written."""
    with writing(path):
        figure.savefig(path, dpi=DOTS_PER_INCH)
    return path
