"""The leaderboard of a bench: flights, tables, a Markdown page and a figure."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from mavfi.analysis import Runs, table
from mavfi.analysis.table import Table
from mavfi.campaign.config import Campaign
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.fingerprint import versions
from mavfi.campaign.run import run_campaigns
from mavfi.cli.progress import Bar
from mavfi.errors import write_text
from mavfi.extras.bench.bench import SCORES, Bench, SelectedPart, checksum, faults_of, frozen_faults, published_rows
from mavfi.extras.bench.scores import Scores, scores, unscored
from mavfi.extras.bench.scores import table as table_of_scores
from mavfi.files import is_file
from mavfi.report import style
from mavfi.report.campaign_report import markdown_table

_COLOURS = (style.BLUE, style.ORANGE, style.GREEN, style.PURPLE, style.SKY, style.AMBER, style.INK)
_DASHES = ("-", "--", ":")
_MOST_ALARMS = 1e4
"""Right limit of the figure (alarms per hour): about three per second."""


@dataclass(frozen=True, slots=True)
class BenchFlights:
    """Selected parts of a bench at a scale, and the folder of their ledgers.

    Attributes:
        bench: The bench.
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
        if len(self.parts) > 1:
            title = f"{len(self.parts)} parts"
        else:
            title = next(iter(self.parts))
        campaigns = {self.folder / name: entry.campaign for name, entry in self.parts.items()}
        with Bar(f"bench: {title}", "runs") as bar:
            run_campaigns(campaigns, executor=LocalExecutor(workers), models_dir=models, progress=bar.show_campaigns)

    @property
    def scored(self) -> dict[str, Campaign]:
        """Campaigns of the parts with `scores` enabled."""
        return {name: entry.campaign for name, entry in self.parts.items() if entry.part.scores}

    def scores(self, workers: int, models: Path | None) -> dict[str, Scores]:
        """Scores of the detectors, in the parts with `scores` enabled."""
        if not self.scored:
            return {}
        with Bar("bench: scores of all detectors", "missions") as bar:
            return scores([self.folder / name for name in self.scored], LocalExecutor(workers), models, bar.show)

    def tables(self, scored: Mapping[str, Scores]) -> dict[str, Table]:
        """The table of each part, and that of the scores: detection at fixed rates of false alarms."""
        tables = {name: self._table(name, entry) for name, entry in self.parts.items()}
        if scored:
            tables[SCORES] = table_of_scores(scored, list(self.scored), unscored(self.scored.values(), scored))
        return tables

    def _table(self, name: str, entry: SelectedPart) -> Table:
        """The table of a part, with notes on agreement with the frozen faults and on omitted schemes."""
        ledger = self.folder / name
        faults = faults_of(ledger)
        write_text(ledger / "faults.csv", faults)
        frozen = frozen_faults(self.bench, name, self.scale)
        same = {None: "no list of them is published", faults: f"as published in {self.bench.name}"}
        drawn = f"{faults.count(chr(10)) - 1} faults, sha256 {checksum(faults)[:16]}…: "
        drawn += same.get(frozen, f"NOT those published in {self.bench.name} (sha256 {checksum(frozen or '')[:16]}…)")
        arms_of_reason = defaultdict[str, list[str]](list)
        for arm, reason in entry.left_out.items():
            arms_of_reason[reason].append(arm)
        left_out = [f"{', '.join(arms)}: not flown ({reason})" for reason, arms in arms_of_reason.items()]
        made = table(Runs.read(ledger), entry.part.view)
        return replace(made, name=name, title=entry.part.title, notes=(drawn, *left_out, *made.notes))

    def beside_published(self, name: str, own: Table) -> Table:
        """The table of a part with the published rows, if its faults are the published ones."""
        faults = self.folder / name / "faults.csv"
        frozen = frozen_faults(self.bench, name, self.scale)
        if not is_file(faults) or faults.read_text(encoding="utf-8") != frozen:
            return own
        return beside_published(own, published_rows(self.bench, name, self.scale), self.bench.name)


def write_leaderboard(
    flown: BenchFlights,
    own: Mapping[str, Table],
    shown: Mapping[str, Table],
    scored: Mapping[str, Scores],
    command: str,
) -> None:
    """Write page, tables and curves of a bench to its folder; `shown`: the tables beside published rows.

    Raises:
        BadInputError: A file cannot be written.
    """
    texts = {"leaderboard.md": leaderboard(shown, flown.bench.name, flown.scale, command)}
    texts |= {f"{name}.csv": table.to_csv() for name, table in own.items()}
    if scored:
        draw_curves(scored, flown.folder / "curves.png")
    for name, content in texts.items():
        write_text(flown.folder / name, content)


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
            colour = _COLOURS[place % len(_COLOURS)]
            dashes = _DASHES[place // len(_COLOURS) % len(_DASHES)]
            _, alarms, shares = zip((0.0, 0.0, 0.0), *own.curve(), strict=True)
            least = 0.5 / own.hours
            x = np.maximum(alarms, least)
            y = 100 * np.array(shares)
            axes.step(x, y, where="post", label=name, color=colour, linestyle=dashes, linewidth=1.8)
            now = np.searchsorted(-own.golden, -1.0), (own.corrupted[own.harmful] > 1.0).mean()  # threshold as shipped
            axes.plot(max(now[0] / own.hours, least), 100 * now[1], "o", color=colour, markeredgecolor="white")
        axes.set(
            xscale="log",
            ylim=(-2, 102),
            xlabel="false alarms per flight hour",
            ylabel="harmful faults detected (%)",
            title="Detection against false alarms",
        )
        axes.grid(visible=True)
        axes.set_xlim(right=_MOST_ALARMS)
        figure.legend(loc="outside lower center", ncols=3, title="markers: thresholds as shipped")
        return style.write(figure, path)
