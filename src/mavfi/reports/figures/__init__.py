"""Figures of reports: `Drawing`s, registered by name.

`figure(runs, name)` returns one figure, `draw(runs, directory, names)` writes several.
"""

from mavfi.reports.figures import campaign, paper, platforms, redundancy, trajectories  # noqa: F401  (registration, in report order)
from mavfi.reports.figures.registry import FIGURES, Drawing, draw, drawing, figure, register

__all__ = ["FIGURES", "Drawing", "draw", "drawing", "figure", "register"]
