"""Links of figures to the runs behind their points, bands and lines; they work in the HTML report only."""

from collections.abc import Iterable, Sequence
from typing import Any
from urllib.parse import urlencode

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

from mavfi.analysis.runs import Runs

RUNS = "#runs?"
RUN = "#run/"
"""Starts of links to a list of runs and to the page of a run."""
DOTS = "dots:"
"""Start of the id of a group of dots, followed by their run ids, separated by blanks."""
IDS = "ids"
"""Key of the run ids in a link, separated by blanks; the page replaces them by the number of a set."""
_TRANSPARENT: dict[str, Any] = {"alpha": 0.0, "linewidth": 0.0, "clip_on": False}
"""Look of the linked shapes, which are preserved in SVG."""
_BAND = 0.7
"""Width of a band relative to that of a row."""


def to_runs(runs: Runs, **label: str) -> str:
    """Link to exactly these runs; the label names them for screen readers."""
    return RUNS + urlencode({**label, IDS: " ".join(runs.values("run_id"))})


def to_run(run_id: str) -> str:
    """Link to the page of a run."""
    return f"{RUN}{run_id}"


def points(axes: Axes, x: Sequence[float] | np.ndarray, y: Sequence[float] | np.ndarray, links: Sequence[str]) -> None:
    """Link points of a panel."""
    axes.scatter(x, y, s=130, zorder=7, **_TRANSPARENT).set_urls(links)


def band(axes: Axes, centre: float, link: str, *, upright: bool) -> None:
    """Link a row of a panel, or a column (`upright`), `_BAND` wide around its centre; points are above it."""
    low = centre - _BAND / 2
    high = centre + _BAND / 2
    # in data units across the band, and from 0 to 1 along it, i.e. over the whole panel
    if upright:
        transform = axes.get_xaxis_transform()
        corners = [(low, 0.0), (low, 1.0), (high, 1.0), (high, 0.0)]
    else:
        transform = axes.get_yaxis_transform()
        corners = [(0.0, low), (1.0, low), (1.0, high), (0.0, high)]
    shape = PolyCollection([corners], urls=[link], zorder=6, transform=transform, **_TRANSPARENT)
    axes.add_collection(shape, autolim=False)


def lines(drawn: Iterable[Artist], link: str) -> None:
    """Link drawn lines or markers themselves, so that each visible part of overlapping lines opens its own runs."""
    for artist in drawn:
        artist.set_url(link)


def dots(drawn: Iterable[Artist], run_ids: Sequence[str]) -> None:
    """Name the run behind each dot of a marker series; a click on a dot opens its run instead of the linked set."""
    for artist in drawn:
        artist.set_gid(DOTS + " ".join(run_ids))
