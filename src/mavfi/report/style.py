"""Common style of figures: a palette safe for colour-blind readers, and typography."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from itertools import cycle, pairwise
from pathlib import Path
from textwrap import wrap
from typing import Any, NamedTuple

import matplotlib.patheffects as effects
import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.ticker import FixedLocator, MaxNLocator
from matplotlib.transforms import Bbox

from mavfi.errors import writing

BLUE = "#0072B2"
ORANGE = "#D55E00"
GREEN = "#009E73"
PURPLE = "#CC79A7"
SKY = "#56B4E9"
AMBER = "#E69F00"
YELLOW = "#B8A800"
"""Colours of the Okabe–Ito palette, the last one darker."""
INK = "#222222"
GREY = "#777777"
PALE = "#DDDDDD"
"""Colours of texts and axes, of secondary ones, and of grids."""

# ---- roles: what a colour means in all pictures; the style sheet of pages has the same as --golden etc. ---
GOLDEN = BLUE
FAULT = ORANGE
RECOVERED = GREEN
"""Flights: without a fault, with one, and with the same one and a detector."""
INJECTION = AMBER
ALARM = PURPLE
"""Marks: the instant or place of a fault, and of an alarm because of it."""
PAPER = INK
"""Values of the paper."""
OBSTACLE = "#D4D4D4"
OBSTACLE_LOOK: Mapping[str, Any] = {"facecolor": OBSTACLE, "edgecolor": "#A8A8A8", "linewidth": 0.5}
OCCUPIED = "#3B3B3B"
"""The world, and what the map holds of it."""


def _halo(width: float) -> list[Any]:
    """A white line of a width (pt) below another, which stands out on lines below both."""
    return [effects.withStroke(linewidth=width, foreground="white")]


FLIGHT_LOOKS: Mapping[str, Mapping[str, Any]] = {
    "golden": {"color": GOLDEN, "linewidth": 6.0, "zorder": 4},
    "injected": {"color": FAULT, "linewidth": 3.0, "zorder": 5, "path_effects": _halo(3.8)},
    "recovered": {
        "color": RECOVERED,
        "linewidth": 1.8,
        "linestyle": (0, (4, 3)),
        "zorder": 6,
        "path_effects": _halo(2.8),
    },
}
"""Paths of flights, as keywords of `Axes.plot`: wide to narrow, so that each is seen where they coincide."""
START_MARK: Mapping[str, Any] = {"marker": "o", "color": INK}
GOAL_MARK: Mapping[str, Any] = {"marker": "s", "color": INK}
INJECTION_MARK: Mapping[str, Any] = {
    "marker": "*",
    "color": INJECTION,
    "markeredgecolor": INK,
    "markeredgewidth": 0.8,
}
ALARM_MARK: Mapping[str, Any] = {"marker": "v", "color": ALARM, "markeredgecolor": INK, "markeredgewidth": 0.8}
CRASH_MARK: Mapping[str, Any] = {"marker": "X", "markeredgecolor": "white"}
"""Marks, without their sizes; the end of a failed flight has the colour of its path."""
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
    (RECOVERED, "^", "--"),
    (PURPLE, "D", "-."),
    (AMBER, "v", ":"),
    (SKY, "P", (0, (1, 1))),
    (INK, "X", (0, (5, 1, 1, 1))),
    (GREY, "h", (0, (6, 2))),
    (YELLOW, "<", (0, (3, 1))),
)
"""Colour, marker and dashes of each arm, distinguishable in greyscale."""


def house_style() -> AbstractContextManager[None]:
    """Context in which figures use the common style; global settings of matplotlib are unchanged."""
    return rc_context(_SETTINGS)


def setting_looks(settings: list[str]) -> dict[str, dict[str, Any]]:
    """Colour and marker by setting: blue discs for golden runs, orange squares for faults, then one style per arm."""
    looks = {"golden": {"color": GOLDEN, "marker": "o"}, "fi": {"color": FAULT, "marker": "s"}}
    arms = [setting for setting in settings if setting not in looks]
    for setting, (colour, marker, _) in zip(arms, cycle(_ARMS), strict=False):
        looks[setting] = {"color": colour, "marker": marker}
    return {setting: looks[setting] for setting in settings}


def curve(look: dict[str, Any], *, wide: bool) -> dict[str, Any]:
    """Colour, dashes and width of a setting's curve."""
    dashes = {colour: line for colour, _, line in _ARMS}
    width = 2.8 if wide else 1.4
    return {"color": look["color"], "linestyle": dashes.get(look["color"], "-"), "linewidth": width}


def setting_label(setting: str) -> str:
    """Display name of a setting: "golden run", "fault", "fault + gaussian"."""
    kind, _, arm = setting.partition("_")
    words = {"golden": "golden run", "fi": "fault", "dr": "fault", "null": "null fault"}.get(kind, kind)
    if arm:
        return f"{words} + {arm}"
    return words


def write(figure: Figure, path: Path, dots_per_inch: float = DOTS_PER_INCH) -> Path:
    """Write a figure in the format given by the file extension; `BadInputError` if the file cannot be written."""
    with writing(path):
        figure.savefig(path, dpi=dots_per_inch)
    return path


# ---- for papers and talks: sizes of letters, marks and lines, texts without overlaps ---------------------------------

COLUMN = 3.5
PAGE = 7.16
"""Widths of one column and of the page (in), in IEEE's two-column format."""
TALK_HEIGHT = 4.5
TALK_RATIO = 16 / 9
"""Height (in) and width / height of figures for talks: shown on a slide, their letters have 17 of 540 pt."""
_TALK_DOTS = 2560
"""Width of figures for talks (pixels)."""


class _LetterSizes(NamedTuple):
    """Font sizes (pt): of all texts; of those in panels that are smaller than tick labels."""

    normal: float
    small: float


_IN_PAPERS = _LetterSizes(7.0, 5.0)
_IN_TALKS = _LetterSizes(10.0, 7.5)
_DOTS_PER_INCH = 600
_PANELS = 2  # maximum number side by side in one column
_SCALE = 0.5
"""Least scale of marks and lines, so that they remain visible."""
_GAP = 2.0
"""Least distance between neighbouring tick labels (pt)."""
_TICKS = (4, 3, 2, 1)
"""Maximum numbers of intervals between ticks, tried in this order."""
_MIN_HEIGHT = 1.8
_MIN_PANEL_HEIGHT = 1.0
_GROWTH = 1.1
"""Least height of a figure and of its panels (in), and factor by which it grows until its names fit."""
_LETTERS_IN_LINE = 12
"""Least number of letters in a line of a wrapped text."""
_SLACK = 1.1
"""Length of a label over that of its axis beyond which it is wrapped."""


def write_figure(figure: Figure, directory: Path, name: str) -> list[Path]:
    """Write NAME.pdf and NAME.png in the width of a column or page; the figure is resized in place.

    Raises:
        BadInputError: A file cannot be written.
    """
    fit_to_column(figure)
    return _write_as(figure, directory, name, (".pdf", ".png"), _DOTS_PER_INCH)


def write_talk_figure(figure: Figure, directory: Path, name: str) -> list[Path]:
    """Write NAME-talk.svg and NAME-talk.png for a slide of 16 to 9; the figure is resized in place.

    Raises:
        BadInputError: A file cannot be written.
    """
    fit_to_slide(figure)
    return _write_as(figure, directory, f"{name}-talk", (".svg", ".png"), _TALK_DOTS / figure.get_figwidth())


def _write_as(figure: Figure, directory: Path, name: str, endings: Sequence[str], dots_per_inch: float) -> list[Path]:
    return [write(figure, directory / f"{name}{ending}", dots_per_inch) for ending in endings]


def fit_to_column(figure: Figure) -> None:
    """Resize a figure to column width, or to page width with subfigures or more than two panels side by side.

    Fonts get journal sizes, marks and lines are reduced with the figure.  Legends and labels are wrapped to the space
    that they have, ticks are thinned out, and names below an axis are turned if they overlap.  The title of a single
    panel is removed, since the caption replaces it.
    """
    panels = [axes for axes in figure.axes if axes.get_subplotspec() is not None]
    limit = figure.get_figheight()
    _resize(figure, panels)
    _arrange(figure, panels, limit, _IN_PAPERS)


def fit_to_slide(figure: Figure) -> None:
    """Resize a figure to 16 to 9, with large letters; a figure with many rows has smaller ones.

    Texts are arranged as by `fit_to_column`.
    """
    panels = [axes for axes in figure.axes if axes.get_subplotspec() is not None]
    height = max(TALK_HEIGHT, 0.75 * figure.get_figheight())
    figure.set_size_inches(TALK_RATIO * height, height)
    _set_letters(figure, _IN_TALKS)
    _arrange(figure, panels, height, _IN_TALKS)
    figure.set_size_inches(TALK_RATIO * height, height)  # what legends and turned names have added


def _arrange(figure: Figure, panels: Sequence[Axes], limit: float, sizes: _LetterSizes) -> None:
    """Wrap, join, turn and thin out the texts of a resized figure, which may grow up to a height (in)."""
    flat = panels
    if figure.subfigs:  # their panels have the scale of a map
        flat = []
    # equal labels below all panels become one: those of narrow panels would overlap
    labels = {axes.get_xlabel() for axes in flat}
    if len(labels) == 1 and "" not in labels:
        for axes in flat:
            axes.set_xlabel("")
        figure.supxlabel(labels.pop(), fontsize=sizes.normal)
    for legend in figure.findobj(Legend):
        _fold_legend(figure, legend, sizes)
    # extents are known only after a layout: each step below needs those that the step before has changed
    figure.draw_without_rendering()
    _fold_texts(figure, panels)
    figure.draw_without_rendering()
    # across, before the height: turned names take some of it
    _turn(figure, [axes.xaxis for axes in flat if _named(axes.xaxis)])
    for axes in flat:
        _thin_out(figure, axes.xaxis)
        if _overlap(figure, axes.xaxis, minor=True):
            axes.tick_params(axis="x", which="minor", rotation=90.0)
    # along the height
    _grow(figure, flat, limit)
    for axes in panels:
        _fold(axes.yaxis.label, _SLACK * axes.bbox.height)
    figure.draw_without_rendering()
    for axes in flat:
        _thin_out(figure, axes.yaxis)


def _resize(figure: Figure, panels: Sequence[Axes]) -> None:
    """Set the size of a figure, and those of its letters, marks and lines."""
    columns = max((axes.get_subplotspec().get_gridspec().ncols for axes in panels), default=1)  # type: ignore[union-attr]
    width, height = figure.get_size_inches()
    target = PAGE
    if columns <= _PANELS and not figure.subfigs:
        target = COLUMN
    # height in proportion, but such that panels are not flat, and never above the one before
    figure.set_size_inches(target, min(height, max(height * target / width, 0.7 * target / columns, _MIN_HEIGHT)))
    _set_letters(figure, _IN_PAPERS)
    # marks and lines
    scale = max(_SCALE, target / width)
    for line in figure.findobj(Line2D):
        line.set_markersize(scale * line.get_markersize())
        line.set_linewidth(scale * line.get_linewidth())
        line.set_markeredgewidth(scale * line.get_markeredgewidth())
    for bars in figure.findobj(LineCollection):
        bars.set_linewidth(list(scale * np.atleast_1d(bars.get_linewidth())))
    if len(panels) == 1:
        panels[0].set_title("", loc="left")


def _fold_texts(figure: Figure, panels: Sequence[Axes]) -> None:
    """Wrap titles and horizontal labels to the width of their panel, figure or subfigure."""
    for axes in panels:
        _fold(axes.xaxis.label, _SLACK * axes.bbox.width)
        _fold(axes._left_title, axes.bbox.width)  # type: ignore[attr-defined]
    for part in (figure, *figure.subfigs):
        for text in (part._suptitle, part._supxlabel):  # type: ignore[attr-defined]
            if text is not None:
                _fold(text, part.bbox.width)  # type: ignore[attr-defined]


def _set_letters(figure: Figure, sizes: _LetterSizes) -> None:
    """Set the sizes of letters; those that are smaller than tick labels remain so."""
    for text in figure.findobj(Text):
        size = sizes.normal
        if text.get_fontproperties().get_size_in_points() < _IN_PAPERS.normal:
            size = sizes.small
        text.set_fontsize(size)


def _fold_legend(figure: Figure, legend: Legend, sizes: _LetterSizes) -> None:
    """Replace a legend by one above the panels, with as many columns as fit; the figure grows by its height."""
    labels = [text.get_text() for text in legend.get_texts()]
    handles = [handle for handle in legend.legend_handles if handle is not None]
    legend.remove()
    for columns in range(len(labels), 0, -1):
        trial = figure.legend(
            handles,
            labels,
            loc="outside upper left",
            ncols=columns,
            fontsize=sizes.normal,
            frameon=False,
            handlelength=1.6,
            columnspacing=1.0,
            borderpad=0.2,
            labelspacing=0.3,
        )
        extent = trial.get_window_extent()
        if columns == 1 or extent.width < figure.bbox.width:
            figure.set_figheight(figure.get_figheight() + extent.height / figure.dpi)
            return
        trial.remove()


def _grow(figure: Figure, panels: Sequence[Axes], limit: float) -> None:
    """Increase the height of a figure, up to a limit (in), until its panels have theirs and names of rows fit."""
    figure.draw_without_rendering()
    while figure.get_figheight() * _GROWTH < limit and any(
        axes.bbox.height < _MIN_PANEL_HEIGHT * figure.dpi or (_named(axes.yaxis) and _overlap(figure, axes.yaxis))
        for axes in panels
    ):
        figure.set_figheight(figure.get_figheight() * _GROWTH)
        figure.draw_without_rendering()


def _named(axis: Axis) -> bool:
    """Whether an axis has names at its ticks, not numbers."""
    return isinstance(axis.get_major_locator(), FixedLocator)


def _fold(text: Text, space: float) -> None:
    """Wrap a text that is longer than its space (pixels)."""
    extent = text.get_window_extent()
    lines = text.get_text().splitlines()
    needed = max(extent.width, extent.height)
    if needed > space:
        letters = max(_LETTERS_IN_LINE, int(max(map(len, lines)) * space / needed))
        text.set_text("\n".join(part for line in lines for part in wrap(line, letters, break_long_words=False)))


def _turn(figure: Figure, axes: Sequence[Axis]) -> None:
    """Turn the names below all panels if they overlap below one; the figure grows by the longest."""
    if any(_overlap(figure, axis) for axis in axes):
        labels = [label for axis in axes for label in axis.get_ticklabels()]
        figure.set_figheight(figure.get_figheight() + max(box.width for box in _boxes(labels)) / figure.dpi)
        for label in labels:
            label.set_rotation(90.0)
        figure.draw_without_rendering()


def _thin_out(figure: Figure, axis: Axis) -> None:
    """Take fewer ticks of numbers if their labels overlap."""
    if _named(axis):
        return
    for intervals in _TICKS:
        if not _overlap(figure, axis):
            return
        axis.set_major_locator(MaxNLocator(intervals, steps=[1, 2, 5, 10]))
        figure.draw_without_rendering()


def _overlap(figure: Figure, axis: Axis, *, minor: bool = False) -> bool:
    """Whether neighbouring tick labels of an axis overlap or nearly touch."""
    gap = _GAP * figure.dpi / 72.0  # 72 pt per inch
    boxes = [box.padded(gap / 2) for box in _boxes(axis.get_ticklabels(minor=minor))]
    return any(box.overlaps(following) for box, following in pairwise(boxes))


def _boxes(texts: Sequence[Text]) -> Iterator[Bbox]:
    """Extents of visible texts (pixels)."""
    for text in texts:
        if text.get_text() and text.get_visible():
            yield Bbox(text.get_window_extent())
