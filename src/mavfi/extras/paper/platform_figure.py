"""Fig. 9 of the paper: flight times by computing platform, for golden runs, faults, and faults with detectors."""

import numpy as np
from matplotlib.figure import Figure

from mavfi.analysis import published as paper
from mavfi.analysis.runs import Runs
from mavfi.campaign.plan import GOLDEN
from mavfi.extras.paper.platform_views import compared, platforms
from mavfi.plugins import Chapter
from mavfi.report import links, style
from mavfi.report.figures import Drawing


def flight_times(runs: Runs) -> Figure | None:
    """Successful flights as points, with median and quartiles; one panel per platform.

    The dashed line is the paper's flight time; the paper does not specify its flights.
    """
    known = platforms(runs)
    flown = compared(runs)
    settings = [GOLDEN, *flown.settings()]
    if not known or len(settings) < 2:
        return None
    figure = Figure(figsize=(1.2 + 2.9 * len(known), 3.9), layout="constrained")
    panels = figure.subplots(1, len(known), sharey=True, squeeze=False)[0]
    looks = style.setting_looks(settings)
    for axes, (environment, platform) in zip(panels, known.items(), strict=True):
        for place, setting in enumerate(settings):
            own = flown.where(environment=environment, setting=setting)
            times = np.sort(own.frame["flight_time_s"].to_numpy())
            if not len(times):
                continue
            spread = place - 0.32 + 0.64 * ((np.arange(len(times)) * 0.618034) % 1.0)
            axes.plot(spread, times, linestyle="", markersize=3, alpha=0.45, markeredgewidth=0, **looks[setting])
            links.band(axes, place, links.to_runs(own, platform=platform, setting=setting), upright=True)
            low, middle, high = np.quantile(times, (0.25, 0.5, 0.75))
            axes.plot([place, place], [low, high], color=style.INK, linewidth=3.2, solid_capstyle="butt")
            axes.plot(place, middle, "o", color="white", markeredgecolor=style.INK, markersize=5, zorder=5)
            axes.annotate(f"{times[-1]:.0f}", (place, times[-1]), (0, 4), textcoords="offset points", ha="center",
                          fontsize=7.5, color=style.INK)  # fmt: skip
        if paper.comparable(runs.campaign, ""):
            printed = paper.figure("platforms", quantity="flight_time_s", platform=platform)
            if printed is not None:
                axes.axhline(printed, color=style.INK, linestyle="--", linewidth=0.9)
                axes.annotate(f"paper: {printed} s", (len(settings) - 0.5, printed), (0, 3), ha="right", fontsize=8,
                              textcoords="offset points", color=style.INK)  # fmt: skip
        names = [style.setting_label(setting).replace(" + ", " +\n") for setting in settings]
        axes.set_xticks(range(len(settings)), names, fontsize=8)
        axes.tick_params(axis="x", length=0)
        axes.set_xlim(-0.5, len(settings) - 0.5)
        axes.grid(axis="y")
        axes.set_title(platform)
    panels[0].set_ylim(0, None)
    panels[0].set_ylabel("flight time (s) of missions that succeed")
    figure.supxlabel("one fault per mission; bar: quartiles; number: worst", fontsize=8.5, color=style.GREY)
    return figure


PLATFORMS = Chapter(
    30, (Drawing("platforms", flight_times, "Flight times on each platform; dashed: the paper's.", general=True),)
)
