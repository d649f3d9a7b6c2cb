"""Fig. 8 of the paper: flight time with redundant processors relative to that with a detector."""

import itertools
import math
from collections.abc import Sequence

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from mavfi.analysis import published as paper
from mavfi.extras.paper.redundancy import DesignConfig, energy_ratio, performance, shipped_designs
from mavfi.extras.paper.redundancy_views import AUTOENCODER, band, ratio, schemes
from mavfi.plugins import Chapter
from mavfi.report import style
from mavfi.report.figures import Drawing

_DESIGN_LOOKS = ((style.BLUE, "o"), (style.ORANGE, "s"), (style.GREEN, "^"), (style.PURPLE, "D"))


def redundancy(designs: Sequence[DesignConfig]) -> Figure:
    """Ratios of flight time (with bands) and of energy by scheme; one panel per vehicle."""
    vehicles = list(dict.fromkeys(design.craft for design in designs))
    calibrations = list(dict.fromkeys(design.calibration for design in designs))
    figure = Figure(figsize=(1.4 + 3.4 * len(vehicles), 3.9), layout="constrained")
    panels = figure.subplots(1, len(vehicles), squeeze=False)[0]
    names, width, from_paper = list(schemes()), 0.7 / len(calibrations), False
    for axes, vehicle in zip(panels, vehicles, strict=True):
        own = [design for design in designs if design.craft == vehicle]
        finite = [value for design in own for name in names
                  for value in (*band(design, name), _energy(design, name)) if math.isfinite(value)]  # fmt: skip
        top = 1.0 + 1.08 * max(0.05, max(finite) - 1.0)
        for design in own:
            place = calibrations.index(design.calibration)
            colour, marker = _DESIGN_LOOKS[place % len(_DESIGN_LOOKS)]
            for x, name in enumerate(names):
                at = x + (place - (len(calibrations) - 1) / 2) * width
                low, high = band(design, name)
                axes.plot([at, at], [low, min(high, top)], color=colour, linewidth=1.8)
                if math.isinf(high):
                    axes.plot(at, top, "^", color=colour, markersize=6, clip_on=False)
                axes.plot(at, min(ratio(design, name), top), marker, color=colour, markersize=6)
                energy = _energy(design, name)
                if math.isfinite(energy):
                    axes.plot(at, energy, marker, color=colour, markersize=6, fillstyle="none")
        for x, name in enumerate(names):
            printed = paper.figure("redundancy_time", vehicle=vehicle, scheme=name)
            if printed is not None:
                from_paper = True
                axes.plot([x - 0.42, x + 0.42], [printed, printed], color=style.INK, zorder=5)
                axes.annotate(f"{printed:.2f}", (x + 0.44, printed), va="center", fontsize=8, color=style.INK)
        axes.set_xticks(range(len(names)), names)
        axes.set_xlim(-0.5, len(names) - 0.35)
        axes.set_ylim(min([1.0, *finite]) - 0.06 * (top - 1.0), top)
        axes.tick_params(axis="x", length=0)
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g} ×")
        axes.grid(axis="y")
        axes.set_title(vehicle.replace("_", " "))
    panels[0].set_ylabel("against the autoencoder scheme")
    looks = itertools.cycle(_DESIGN_LOOKS)
    handles = [
        Line2D([], [], linestyle="", marker=marker, color=color, label=f"flight time, {name}")
        for name, (color, marker) in zip(calibrations, looks, strict=False)
    ]
    handles += [
        Line2D([], [], linestyle="", marker="o", color=style.GREY, fillstyle="none", label="energy (hover power)"),
        Line2D([], [], color=style.GREY, linewidth=1.8, label="band; triangle: cannot hover"),
    ]
    handles += [Line2D([], [], color=style.INK, label="the paper's figure")] if from_paper else []
    columns = min(3, 1 + len(vehicles))
    figure.legend(handles=handles, loc="outside upper left", ncols=columns, fontsize=8.5, columnspacing=1.2,
                  handlelength=1.8)  # fmt: skip
    return figure


def _energy(design: DesignConfig, scheme: str) -> float:
    return energy_ratio(performance(design, *schemes()[scheme]), performance(design, *schemes()[AUTOENCODER]))


REDUNDANCY = Chapter(40, (
    Drawing(
        "redundancy", lambda _: redundancy(shipped_designs()),
        "Flight time with redundant processors over that with a detector, by the visual performance model; black: the "
        "paper's figure.",
    ),
))  # fmt: skip
