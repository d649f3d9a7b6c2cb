"""Figures for papers: PDF and PNG at column width, with the plotted data as CSV."""

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.container import ErrorbarContainer
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D

from mavfi.errors import writing
from mavfi.reports.column import fit_to_column

_DOTS_PER_INCH = 600
_FIELDS = ("panel", "series", "x", "x_label", "y", "y_label", "low", "high")
Row = dict[str, Any]


def write_figure(figure: Figure, directory: Path, name: str) -> list[Path]:
    """Write NAME.pdf, NAME.png and NAME.csv; the figure is resized in place.

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


def drawn_data(figure: Figure) -> Iterator[Row]:
    """Extract the plotted data: one row per point with panel, series, coordinates, category labels and interval."""
    for place, axes in enumerate(figure.axes):
        panel = axes.get_title(loc="left") or axes.get_title() or str(place)
        names = _names(axes)
        for row in _points(axes):
            yield {"panel": panel, **row, "x_label": names[0].get(round(row["x"]), ""),
                   "y_label": names[1].get(round(row["y"]), "")}  # fmt: skip


def _names(axes: Axes) -> tuple[dict[int, str], dict[int, str]]:
    """Category labels of the x and y axes by tick position; empty for numeric axes."""
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
    """Points of error bars and lines of a panel."""
    held: set[int] = set()
    labels = _colours(axes)
    for container in axes.containers:
        if isinstance(container, ErrorbarContainer):
            line, caps, bars = container
            held |= {id(one) for one in (line, *caps)}
            yield from _with_intervals(line, bars, labels)
    for line in axes.lines:
        if id(line) not in held and line.get_transform() == axes.transData:
            yield from _rows(_series(line, labels), np.column_stack([line.get_xdata(), line.get_ydata()]))


def _colours(axes: Axes) -> dict[str, str]:
    """Series labels by colour, from the legends of panel and figure."""
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
