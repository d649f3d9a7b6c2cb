"""Figures of reports: `Drawing`s, by name.

`figure(runs, name)` returns one figure, `draw(runs, directory, names)` writes several.
"""

from mavfi.report.figures.registry import FIGURES, Drawing, draw, drawing, figure

__all__ = ["FIGURES", "Drawing", "draw", "drawing", "figure"]
