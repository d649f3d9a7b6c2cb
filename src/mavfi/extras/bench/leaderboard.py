"""The leaderboard of a bench: a Markdown page and a figure."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from mavfi.analysis.table import Table
from mavfi.campaign.fingerprint import versions
from mavfi.extras.bench.scores import Scores
from mavfi.report import style
from mavfi.report.campaign_report import markdown_table

_COLOURS = (style.BLUE, style.ORANGE, style.GREEN, style.PURPLE, style.SKY, style.AMBER, style.INK)
_DASHES = ("-", "--", ":")
_MOST_ALARMS = 1e4
"""Right limit of the figure (alarms per hour): about three per second."""


def leaderboard(tables: Mapping[str, Table], bench: str, scale: str, command: str) -> str:
    """All tables of a bench in Markdown, with date, scale and versions, and the command for a custom detector."""
    flown = " · ".join(f"{name} {version}" for name, version in versions().items())
    parts = [
        f"# Leaderboard of {bench}",
        "Detectors and recovery schemes, each flown on the same missions and the same faults.  The same tables for a "
        "detector of your own (`--part sites` flies one part alone; all of them take hours at scale paper):",
        f"    {command}",
        f"Flown on {date.today().isoformat()} at scale {scale}: {flown}.",
        *map(markdown_table, tables.values()),
    ]
    return "\n\n".join(parts) + "\n"


def beside_published(own: Table, published: Sequence[Mapping[str, str]], bench: str) -> Table:
    """A table with the published rows of other schemes above its own, within each group of rows.

    Args:
        own: Table with one row per scheme, or per group and scheme: the last key column names the scheme.
        published: Rows as text, by heading.
        bench: Name of the bench that published them.

    Returns:
        The table; published cells of columns that did not exist then are empty.
    """
    scheme = own.columns[own.keys - 1]
    known = dict.fromkeys(own.column(scheme.key))
    others = [row for row in published if scheme.heading in row and row[scheme.heading] not in known]
    if not others:
        return own
    nothing: tuple[tuple[str, ...], ...] = ((),) * len(own.columns)
    rows = [(tuple(row.get(column.heading) for column in own.columns), nothing) for row in others]
    rows += zip(own.rows, own.behind or [nothing] * len(own.rows), strict=True)
    groups = list(dict.fromkeys(row[: own.keys - 1] for row, _ in rows))
    rows.sort(key=lambda pair: groups.index(pair[0][: own.keys - 1]))  # stable: published rows remain above
    note = (
        f"flown here: {', '.join(map(str, known))}; the other rows are those published in {bench}, on the same faults"
    )
    behind = [ids for _, ids in rows] if own.behind else ()
    return replace(own, rows=[row for row, _ in rows], notes=(note, *own.notes), behind=behind)


def draw_curves(found: Mapping[str, Scores], path: Path) -> Path:
    """Draw detection of harmful faults against false alarms per hour, one curve per detector.

    False-alarm rates of 0 are drawn at half an alarm in the exposure.

    Raises:
        BadInputError: The file cannot be written.
    """
    with style.house_style():
        figure = Figure(figsize=(7.2, 4.2), layout="constrained")
        axes = figure.subplots()
        judging = {
            name: own for name, own in found.items() if own.area() is not None and len(own.golden) + own.corrupted.any()
        }
        for place, (name, own) in enumerate(judging.items()):
            colour, dashes = _COLOURS[place % len(_COLOURS)], _DASHES[place // len(_COLOURS) % len(_DASHES)]
            _, alarms, shares = zip((0.0, 0.0, 0.0), *own.curve(), strict=True)
            least = 0.5 / own.hours
            x, y = np.maximum(alarms, least), 100 * np.array(shares)
            axes.step(x, y, where="post", label=name, color=colour, linestyle=dashes, linewidth=1.8)
            now = np.searchsorted(-own.golden, -1.0), (own.corrupted[own.harmful] > 1.0).mean()  # threshold as shipped
            axes.plot(max(now[0] / own.hours, least), 100 * now[1], "o", color=colour, markeredgecolor="white")
        axes.set(xscale="log", ylim=(-2, 102), xlabel="false alarms per flight hour",
                 ylabel="harmful faults detected (%)", title="Detection against false alarms")  # fmt: skip
        axes.grid(visible=True)
        axes.set_xlim(right=_MOST_ALARMS)
        figure.legend(loc="outside lower center", ncols=3, title="markers: thresholds as shipped")
        return style.write(figure, path)
