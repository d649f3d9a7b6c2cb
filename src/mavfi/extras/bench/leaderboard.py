"""The leaderboard of a bench: flights, tables, a Markdown page and a figure."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mavfi.analysis.runs import Runs
from mavfi.analysis.table import Table
from mavfi.analysis.views import table
from mavfi.campaign.begin import begin
from mavfi.campaign.config import Campaign
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.fingerprint import versions
from mavfi.campaign.run import run_campaigns
from mavfi.errors import write_text
from mavfi.extras.bench.bench import (
    SCORES_TABLE,
    Bench,
    SelectedPart,
    checksum,
    faults_of,
    frozen_faults,
    published_rows,
    scheme_of,
)
from mavfi.extras.bench.scores import Scores, scores, unscored
from mavfi.extras.bench.scores import table as table_of_scores
from mavfi.files import is_file, make_folder
from mavfi.report import style
from mavfi.report.campaign_report import markdown_table
from mavfi.report.progress import Bar
from mavfi.report.text import shown

_COLOURS = (style.BLUE, style.ORANGE, style.GREEN, style.PURPLE, style.SKY, style.AMBER, style.INK)
_DASHES = ("-", "--", ":")
_MAX_ALARMS = 1e4
"""Right limit of the figure (alarms per hour): about three per second."""


@dataclass(frozen=True, slots=True)
class BenchFlights:
    """Selected parts of a bench at a scale, and the folder of their ledgers.

    Attributes:
        bench: The bench as shipped, whatever schemes are selected.
        parts: The selected parts.
        scale: Size of its campaigns.
        folder: Contains a folder for each part.
    """

    bench: Bench
    parts: Mapping[str, SelectedPart]
    scale: str
    folder: Path

    def fly(self, workers: int, models: Path | None) -> None:
        """Fly the parts together: those that fly the same missions share their golden flights."""
        title = next(iter(self.parts))
        if len(self.parts) > 1:
            title = f"{len(self.parts)} parts"
        with Bar(f"bench: {title}", "runs") as bar:
            campaigns = {}
            for name, selected in self.parts.items():
                ledger = self.folder / name
                campaigns[ledger] = begin(selected.campaign, ledger, models_dir=models)
            run_campaigns(campaigns, executor=LocalExecutor(workers), progress=bar.show_campaigns)

    @property
    def scored_campaigns(self) -> dict[str, Campaign]:
        """Campaigns of the parts with `scores` enabled."""
        return {name: selected.campaign for name, selected in self.parts.items() if selected.part.scores}

    def scores(self, workers: int, models: Path | None) -> dict[str, Scores]:
        """Scores of the detectors, in the parts with `scores` enabled."""
        if not self.scored_campaigns:
            return {}
        with Bar("bench: scores of all detectors", "missions") as bar:
            return scores(
                [self.folder / name for name in self.scored_campaigns], LocalExecutor(workers), models, bar.show
            )

    def tables(self, scores_by_arm: Mapping[str, Scores]) -> dict[str, Table]:
        """The table of each part, and that of the scores: detection at fixed rates of false alarms."""
        tables = {name: self._table(name, selected) for name, selected in self.parts.items()}
        if scores_by_arm:
            reasons = unscored(self.scored_campaigns.values(), scores_by_arm)
            tables[SCORES_TABLE] = table_of_scores(scores_by_arm, list(self.scored_campaigns), reasons)
        return tables

    def _table(self, name: str, selected: SelectedPart) -> Table:
        """The table of a part, with its remarks among the notes."""
        view = table(Runs.read(self.folder / name), selected.part.view)
        return replace(view, name=name, title=selected.part.title, notes=(*self.remarks(name), *view.notes))

    def remarks(self, name: str) -> tuple[str, ...]:
        """Agreement of the faults of a part with the frozen ones, and omitted schemes; the faults are written, too."""
        selected = self.parts[name]
        ledger = self.folder / name
        faults = faults_of(ledger)
        write_text(ledger / "faults.csv", faults)
        frozen = frozen_faults(self.bench, name, self.scale)
        if frozen is None:
            agreement = "no list of them is published"
        elif frozen == faults:
            agreement = f"as published in {self.bench.name}"
        else:
            agreement = f"NOT those published in {self.bench.name} (sha256 {checksum(frozen)[:16]}…)"
        count = faults.count("\n") - 1  # without the heading
        faults_remark = f"{count} faults, sha256 {checksum(faults)[:16]}…: {agreement}"

        arms_of_reason = defaultdict[str, list[str]](list)
        for arm, reason in selected.left_out.items():
            arms_of_reason[reason].append(arm)
        return faults_remark, *(f"{', '.join(arms)}: not flown ({reason})" for reason, arms in arms_of_reason.items())

    def beside_others(self, name: str, flown: Table) -> Table:
        """The table of a part with rows of other schemes on the same faults.

        These are the published rows of the bench's schemes; for a part without any, the flown ones in the bench's
        default folder, if there are.
        """
        path = self.folder / name / "faults.csv"
        if not is_file(path):
            return flown
        faults = path.read_text(encoding="utf-8")
        if faults == frozen_faults(self.bench, name, self.scale):
            published = published_rows(self.bench, name, self.scale)
            rows = [row for row in published if scheme_of(row) in self.bench.arms]
            return beside_published(flown, rows, f"published in {self.bench.name}")
        stored = default_folder(self.scale) / name
        if is_file(stored / "faults.csv") and (stored / "faults.csv").read_text(encoding="utf-8") == faults:
            rows = text_rows(table(Runs.read(stored), self.parts[name].part.view))
            return beside_published(flown, rows, f"flown in {stored}")
        return flown


def default_folder(scale: str, names: Iterable[str] = ()) -> Path:
    """Default folder of a bench at a scale, with its own schemes or with those of other names."""
    return Path("out", "-".join(["bench", scale, *names]))


def text_rows(full: Table) -> list[dict[str, str]]:
    """Rows of a table as text by heading."""
    columns, lines = shown(full)
    headings = [column.heading for column in columns]
    return [dict(zip(headings, cells, strict=True)) for cells in lines]


def write_leaderboard(
    flights: BenchFlights,
    tables: Mapping[str, Table],
    compared_tables: Mapping[str, Table],
    scores_by_arm: Mapping[str, Scores],
    command: str,
) -> None:
    """Write page, tables and curves of a bench to its folder.

    Args:
        flights: The flights.
        tables: Their tables.
        compared_tables: The same tables with published rows.
        scores_by_arm: Scores by scheme.
        command: Command that flies the same parts with a custom detector.

    Raises:
        BadInputError: A file cannot be written.
    """
    make_folder(flights.folder)
    texts = {"leaderboard.md": leaderboard(compared_tables, flights.bench.name, flights.scale, command)}
    texts |= {f"{name}.csv": table.to_csv() for name, table in tables.items()}
    if scores_by_arm:
        draw_curves(scores_by_arm, flights.folder / "curves.png")
    for name, content in texts.items():
        write_text(flights.folder / name, content)


def leaderboard(tables: Mapping[str, Table], bench: str, scale: str, command: str) -> str:
    """All tables of a bench in Markdown, with date, scale and versions, and the command for a custom detector."""
    with_versions = " · ".join(f"{name} {version}" for name, version in versions().items())
    parts = [
        f"# Leaderboard of {bench}",
        "Detectors and recovery schemes, each flown on the same missions and the same faults.  The same tables for a "
        "detector of your own (`--part sites` flies one part alone; all of them take hours at scale paper):",
        f"    {command}",
        f"Flown on {date.today().isoformat()} at scale {scale}: {with_versions}.",
        *map(markdown_table, tables.values()),
    ]
    return "\n\n".join(parts) + "\n"


def beside_published(flown: Table, published: Sequence[Mapping[str, str]], origin: str) -> Table:
    """A table with the published or stored rows of other schemes above its own, within each group of rows.

    Args:
        flown: Table with one row per scheme, or per group and scheme: the last key column names the scheme.
        published: Rows as text, by heading.
        origin: Where they are from, e.g. "published in mavfi-bench-1".

    Returns:
        The table; published cells of columns that did not exist then are empty.
    """
    scheme = flown.columns[flown.keys - 1]
    schemes = dict.fromkeys(flown.column(scheme.key))
    others = [row for row in published if scheme.heading in row and row[scheme.heading] not in schemes]
    if not others:
        return flown

    # Rows with the runs behind each cell, of which published rows have none.
    no_runs: tuple[tuple[str, ...], ...] = ((),) * len(flown.columns)
    rows = [(tuple(row.get(column.heading) for column in flown.columns), no_runs) for row in others]
    rows += zip(flown.rows, flown.behind or [no_runs] * len(flown.rows), strict=True)
    groups = list(dict.fromkeys(row[: flown.keys - 1] for row, _ in rows))
    rows.sort(key=lambda pair: groups.index(pair[0][: flown.keys - 1]))  # stable: published rows remain above

    names = ", ".join(map(str, schemes))
    note = f"flown here: {names}; the other rows are those {origin}, on the same faults"
    behind: Sequence[tuple[tuple[str, ...], ...]] = ()
    if flown.behind:
        behind = [ids for _, ids in rows]
    return replace(flown, rows=[row for row, _ in rows], notes=(note, *flown.notes), behind=behind)


class LineEnd(NamedTuple):
    """The right end of a line: its height (data), and the name and colour of the line."""

    y: float
    name: str
    colour: str


def name_lines(axes: Axes, ends: Sequence[LineEnd]) -> None:
    """Name lines to the right of the axes, each with a thin leader to its end; names keep a distance.

    Args:
        axes: With its final limits.
        ends: The lines.
    """
    size = 8.5  # of the names (pt)
    low, high = axes.get_ylim()
    height_in = 0.8 * axes.figure.get_figheight()  # type: ignore[union-attr] # about that of the axes
    gap = (high - low) * 1.3 * size / (72.0 * height_in)
    ordered = sorted(ends, key=lambda end: -end.y)

    # Heights of the names: from above, each at its line or a gap below the name above it; from below, into the axes.
    heights: list[float] = []
    for end in ordered:
        ceiling = high
        if heights:
            ceiling = heights[-1] - gap
        heights.append(min(end.y, ceiling))
    floor = low
    for index in reversed(range(len(heights))):
        heights[index] = max(heights[index], floor)
        floor = heights[index] + gap

    # Names and leaders.
    beside = axes.get_yaxis_transform()  # x: share of the width; y: data
    for end, height in zip(ordered, heights, strict=True):
        axes.annotate(
            end.name,
            (1.0, end.y),
            (1.04, height),
            xycoords=beside,
            textcoords=beside,
            va="center",
            fontsize=size,
            color=end.colour,
            annotation_clip=False,
            arrowprops={
                "arrowstyle": "-",
                "color": end.colour,
                "linewidth": 0.7,
                "relpos": (0.0, 0.5),
                "shrinkA": 2,
                "shrinkB": 0,
            },
        )


def draw_curves(scores_of_schemes: Mapping[str, Scores], path: Path) -> Path:
    """Draw detection of harmful faults against false alarms per hour, one curve per detector.

    False-alarm rates of 0 are drawn at half an alarm in the exposure.

    Raises:
        BadInputError: The file cannot be written.
    """
    with style.house_style():
        figure = Figure(figsize=(7.2, 4.2), layout="constrained")
        axes = figure.subplots()
        # A curve needs harmful faults, and a publication that scores above 0.
        drawable = [
            (name, scheme)
            for name, scheme in scores_of_schemes.items()
            if scheme.area() is not None and (len(scheme.golden) or scheme.corrupted.any())
        ]
        ends = []
        for number, (name, scheme) in enumerate(drawable):
            colour = _COLOURS[number % len(_COLOURS)]
            dashes = _DASHES[number // len(_COLOURS) % len(_DASHES)]
            # The curve over all thresholds,
            _, alarms, shares = zip((0.0, 0.0, 0.0), *scheme.curve(), strict=True)
            lowest_rate = 0.5 / scheme.hours
            # the last share holds up to the edge, where the curve has its name
            x = np.maximum([*alarms, max(_MAX_ALARMS, alarms[-1])], lowest_rate)
            y = 100 * np.array([*shares, shares[-1]])
            axes.step(x, y, where="post", color=colour, linestyle=dashes, linewidth=1.8)
            at_the_edge = y[np.searchsorted(x, _MAX_ALARMS, side="right") - 1]
            ends.append(LineEnd(at_the_edge, name, colour))
            # and its point at the threshold as shipped.
            false_alarms = np.searchsorted(-scheme.golden, -1.0)
            detected = (scheme.harmful_scores > 1.0).mean()
            x_shipped = max(false_alarms / scheme.hours, lowest_rate)
            axes.plot(x_shipped, 100 * detected, "o", color=colour, markeredgecolor="white")
        axes.set(
            xscale="log",
            ylim=(-2, 102),
            xlabel="false alarms per flight hour (dots: thresholds as shipped)",
            ylabel="harmful faults detected (%)",
            title="Detection against false alarms",
        )
        axes.grid(visible=True)
        axes.set_xlim(right=_MAX_ALARMS)
        name_lines(axes, ends)
        return style.write(figure, path)
