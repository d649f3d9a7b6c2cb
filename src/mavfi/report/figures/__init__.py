"""Figures of reports: `Drawing`s, registered by name.

`figure(runs, name)` returns one figure, `draw(runs, directory, names)` writes several.
"""

# Imports register the drawings, in the order of reports.
# isort: off
from mavfi.report.figures import campaign  # noqa: F401
from mavfi.extras.paper import figures, platform_figure, redundancy_figure, trajectories  # noqa: F401

# isort: on
from mavfi.report.figures.registry import FIGURES, Drawing, draw, drawing, figure, register

__all__ = ["FIGURES", "Drawing", "draw", "drawing", "figure", "register"]
