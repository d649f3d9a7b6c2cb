"""Figures for papers: PDF and PNG in the width of a column, with what is drawn as CSV."""

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.container import BarContainer, ErrorbarContainer
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.text import Text

from mavfi.errors import writing

COLUMN, PAGE = 3.5, 7.16
"""Width of one column, and of both (in), of IEEE's two-column format."""
_LARGEST_LETTERS, _SMALLEST_LETTERS = 8.0, 6.0  # points of typography
_PANELS = 2  # side by side in one column
_DOTS_PER_INCH = 600
_FIELDS = ("panel", "series", "x", "x_label", "y", "y_label", "low", "high")
Row = dict[str, Any]


def write_figure(figure: Figure, directory: Path, name: str) -> list[Path]:
    """Write NAME.pdf, NAME.png and NAME.csv; the figure is made narrow for it.

    Raises:
        BadInputError: A file cannot be written.
    """
    rows = list(drawn_data(figure))
    fit_to_column(figure)
    paths = [directory / f"{name}{ending}" for ending in (".pdf", ".png", ".csv")]
    for path in paths[:2]:
        with writing(path):
            figure.savefig(path, dpi=_DOTS_PER_INCH)
    with writing(paths[2]), paths[2].open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, _FIELDS, lineterminator="\n", restval="")
        table.writeheader()
        table.writerows(rows)
    return paths


def fit_to_column(figure: Figure) -> None:
    """Give a figure the width of a column, or of the page where it has more than two panels side by side."""
    width, height = figure.get_size_inches()
    columns = max((axes.get_subplotspec().get_gridspec().ncols for axes in figure.axes if axes.get_subplotspec()),
                  default=1)  # fmt: skip
    target = COLUMN if columns <= _PANELS else PAGE
    if target >= width:
        return
    figure.set_size_inches(target, max(height * target / width, min(height, 0.75 * target)))
    letters = _LARGEST_LETTERS if target == PAGE else 0.9 * _LARGEST_LETTERS
    for text in figure.findobj(Text):
        text.set_fontsize(max(_SMALLEST_LETTERS, min(text.get_fontsize(), letters)))
    for legend in figure.findobj(Legend):
        legend.set_ncols(max(1, int(target / 1.25)))


def drawn_data(figure: Figure) -> Iterator[Row]:
    """What a figure shows: one row for each point, with its panel, series, interval, and the names of its places."""
    for place, axes in enumerate(figure.axes):
        panel = axes.get_title(loc="left") or axes.get_title() or str(place)
        names = _names(axes)
        for row in _points(axes):
            yield {"panel": panel, **row, "x_label": names[0].get(round(row["x"]), ""),
                   "y_label": names[1].get(round(row["y"]), "")}  # fmt: skip


def _names(axes: Axes) -> tuple[dict[int, str], dict[int, str]]:
    """Names of places on axes of categories; empty on axes of numbers."""
    found = []
    for axis in (axes.xaxis, axes.yaxis):
        texts = [text.get_text() for text in axis.get_ticklabels()]
        ticks = axis.get_ticklocs()
        named = any(text and not _is_number(text) for text in texts)
        found.append({round(tick): text for tick, text in zip(ticks, texts, strict=False)} if named else {})
    return found[0], found[1]


def _is_number(text: str) -> bool:
    try:
        float(text.replace("−", "-").replace(" ", "").rstrip("%"))
    except ValueError:
        return False
    return True


def _points(axes: Axes) -> Iterator[Row]:
    """Points of error bars, bars, lines, scattered marks and images of a panel."""
    held: set[int] = set()
    labels = _colours(axes)
    for container in axes.containers:
        if isinstance(container, ErrorbarContainer):
            line, caps, bars = container
            held |= {id(one) for one in (line, *caps)}
            yield from _with_intervals(line, bars, labels)
        elif isinstance(container, BarContainer):
            for bar in container.patches:
                x, y = bar.get_x() + bar.get_width() / 2, bar.get_y() + bar.get_height()
                yield {"series": str(container.get_label()).lstrip("_"), "x": x, "y": y, "low": bar.get_y()}
    for line in axes.lines:
        if id(line) not in held and line.get_transform() == axes.transData:
            yield from _rows(_series(line, labels), np.column_stack([line.get_xdata(), line.get_ydata()]))
    for collection in axes.collections:
        if isinstance(collection, PathCollection) and collection.get_alpha() != 0:
            yield from _rows(str(collection.get_label()).lstrip("_"), np.asarray(collection.get_offsets()))
    for image in axes.images:
        cells = np.ma.filled(np.ma.asarray(image.get_array(), np.float64), np.nan)
        for (row, column), value in np.ndenumerate(cells) if cells.ndim == 2 else ():
            yield {"series": f"{value:.6g}", "x": float(column), "y": float(row)}


def _colours(axes: Axes) -> dict[str, str]:
    """Names of series by colour, of the legends of the figure."""
    legends = [*axes.findobj(Legend), *axes.get_figure().legends]  # type: ignore[union-attr]
    return {
        str(handle.get_color()): text.get_text()
        for legend in legends
        for handle, text in zip(legend.legend_handles, legend.get_texts(), strict=False)
        if isinstance(handle, Line2D)
    }


def _series(line: Line2D | None, labels: dict[str, str]) -> str:
    if line is None:
        return ""
    own = str(line.get_label())
    return labels.get(str(line.get_color()), "") if own.startswith("_") else own


def _with_intervals(line: Line2D | None, bars: Sequence[Any], labels: dict[str, str]) -> Iterator[Row]:
    if line is None:
        return
    points = np.column_stack([line.get_xdata(), line.get_ydata()])
    segments = bars[0].get_segments() if bars else []
    for place, row in enumerate(_rows(_series(line, labels), points)):
        if place < len(segments):
            (x0, y0), (x1, y1) = segments[place]
            low, high = (y0, y1) if x0 == x1 else (x0, x1)
            row |= {"low": float(low), "high": float(high)}
        yield row


def _rows(series: str, points: np.ndarray) -> Iterator[Row]:
    for x, y in np.asarray(points, np.float64).reshape(-1, 2):
        yield {"series": series, "x": float(x), "y": float(y)}
