"""Pages of results: every table as CSV, and a short page with the rows that matter.

    make results NAME=sensors          # = python -m tools.results sensors

A page is docs/results/NAME.md; its tables are docs/results/tables/NAME/*.csv, with all rows, n and intervals.  A name
of `CAMPAIGNS` flies its campaigns at scale paper to out/, or resumes them; the other names are modules of `MODULES`.
"""

import os
import runpy
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from mavfi.analysis.table import Table
from mavfi.api import load, table
from mavfi.errors import BadInputError
from mavfi.report.text import header, markdown_grid, shown
from mavfi.states import WATCHING
from tools.markers import DOCS, ROOT, banner

RESULTS = DOCS / "results"
TABLES = RESULTS / "tables"
Row = Mapping[str, str]
"""Cells as text by heading."""


@dataclass(frozen=True, slots=True)
class Excerpt:
    """Rows of a table that are shown on a page.

    Attributes:
        file: Name of the table's file, without `.csv`.
        keep: Whether a row is shown.
        columns: Headings of the columns that are shown; () = all.
        explained: Headings with which notes begin that are shown; () = all notes of the columns that are shown.
    """

    file: str
    keep: Callable[[Row], bool] = lambda row: True
    columns: tuple[str, ...] = ()
    explained: tuple[str, ...] = ()

    def markdown(self, full: Table) -> str:
        """The rows as a Markdown table.

        Raises:
            ValueError: No row is left, or a column does not exist: the page would show nothing.
        """
        columns, lines = shown(full)
        headings = [column.heading for column in columns]
        headings_shown = list(self.columns or headings)
        all_rows = [dict(zip(headings, cells, strict=True)) for cells in lines]
        rows = [row for row in all_rows if self.keep(row)]
        missing = set(headings_shown) - set(headings)
        if not rows or missing:
            raise ValueError(f"{self.file}: no rows to show, or no columns {sorted(missing)}; has {headings}")
        return markdown_grid(headings_shown, [[row[heading] for heading in headings_shown] for row in rows])

    def notes(self, full: Table) -> list[str]:
        """Notes of the table, without those that explain columns which are not shown."""
        headings = [column.heading for column in full.columns]
        hidden = set(headings) - set(self.columns or headings)
        # a note that explains a column begins with its heading
        notes = {note: note.partition(":")[0].partition(",")[0] for note in full.notes}
        if self.explained:
            return [note for note, heading in notes.items() if heading in self.explained]
        return [note for note, heading in notes.items() if heading not in hidden]


def write(
    name: str,
    title: str,
    text: str,
    tables: Mapping[str, Table],
    excerpts: Sequence[Excerpt],
    about: Sequence[str] = (),
    keep: Sequence[str] = (),
    command: str = "",
) -> Path:
    """Write the tables of a page as CSV, and the page.

    Args:
        name: Name of the page, of its folder of tables, and of `make results NAME=...`.
        title: Heading.
        text: What the reader learns, in a sentence or two.
        tables: All tables, by name of the file.
        excerpts: Rows that the page shows.
        about: Lines on what was flown.
        keep: Names of files of tables that others write; all further ones of the folder are removed.
        command: Command that writes the page; "" = `make results NAME=...`.

    Returns:
        The page.
    """
    # the tables, in place of the former ones
    folder = TABLES / name
    folder.mkdir(parents=True, exist_ok=True)
    for stale in {path.stem for path in folder.glob("*.csv")} - {*tables, *keep}:
        (folder / f"{stale}.csv").unlink()
    for file, full in tables.items():
        (folder / f"{file}.csv").write_text(full.to_csv(), encoding="utf-8")

    # the page: text, excerpts, links to all tables, notes
    grids = [excerpt.markdown(tables[excerpt.file]) for excerpt in excerpts]
    notes = dict.fromkeys(note for excerpt in excerpts for note in excerpt.notes(tables[excerpt.file]))
    links = [f"- [{full.title}](tables/{name}/{file}.csv): {len(full.rows)} rows" for file, full in tables.items()]
    parts = [f"# {title}", text, *grids, "All rows:", "\n".join(links)]
    if notes or about:
        parts.append("\n".join(f"- {line}" for line in (*about, *notes)))
    page = RESULTS / f"{name}.md"
    page.write_text(banner(command or f"make results NAME={name}") + "\n\n".join(parts) + "\n", encoding="utf-8")
    return page


# ---- pages of campaigns ---------------------------------------------------------------------------------------------
@dataclass(frozen=True, slots=True)
class CampaignPage:
    """What a page says of campaigns.

    Attributes:
        campaigns: Names of the views whose tables are written, by name of the campaign.
        excerpts: Rows that are shown; a file is CAMPAIGN-VIEW, or VIEW if there is one campaign.
    """

    title: str
    text: str
    campaigns: Mapping[str, tuple[str, ...]]
    excerpts: tuple[Excerpt, ...]


SUMMARY = ("lost", "brought back", "lost under it", "only it lost", "late, in time")
CAMPAIGNS = {
    "lasting": CampaignPage(
        "Faults that last",
        "`recommended` brings back nearly all missions from a fault that lasts a second, and few from one that lasts "
        "ten: after five restarts of a node (2.4 s away together) wrong values pass; the degraded mode `hold` then "
        "gives the mission up and keeps the vehicle in the air. One bit of a field stays stuck (*intermittent*: in a "
        "fifth of the publications; *twice*: the resent value as well), or adjacent bits flip once (burst); every "
        "duration has the same draws of field, instant and bit. "
        "How: [faults](../reference/faults.md#definitions).",
        {"lasting": ("schemes", "schemes_by_duration", "schemes_by_target")},
        (
            Excerpt("schemes", columns=("scheme", "faults", *SUMMARY)),
            Excerpt(
                "schemes_by_duration",
                lambda row: row["scheme"] in ("recommended", "hold") and row["fault"] not in ("twice", "burst of 4"),
                ("fault", "scheme", "lost", "brought back", "vehicle saved"),
            ),
        ),
    ),
    "protected": CampaignPage(
        "Protected kernels, a detector, and restarts",
        "Missions are lost to a planner that dies: `recommended`, which restarts it, loses none, nor does a planner "
        "that is protected in full; the plan for 10 % of a flight's kernel time (`ten_percent`) buys fewer silent "
        "corruptions, not missions. `full` protects pid and rrt_connect in full, which leaves them no silent "
        "corruption ([hardening](../how-to/hardening.md)).",
        {"protected": ("kernel_effects_by_setting", "schemes_instructions", "failures_per_hour")},
        (
            Excerpt(
                "schemes_instructions",
                columns=("scheme", "faults", "lost", "brought back", "lost under it"),
                explained=("lost",),
            ),
            Excerpt(
                "kernel_effects_by_setting",
                lambda row: row["kernel"] in ("pid", "rrt_connect") and row["setting"].startswith("fi"),
                ("kernel", "setting", "n", "sdc", "due", "detected"),
                explained=("n",),
            ),
        ),
    ),
    "sensors": CampaignPage(
        "Failing sensors and motors",
        "A failing motor or gyro loses two missions of three, a failing depth camera one of four; the paper's "
        "Gaussian detector changes none of this, nor does flying on the estimator. Each unit fails from a random "
        "instant to the end of the flight, one of eight types in equal shares: "
        "[faults](../reference/faults.md#sensors-and-motors).",
        {"sensors": ("by_unit", "by_failure", "by_unit_and_environment")},
        (
            Excerpt("by_unit", lambda row: row["setting"] in ("fi", "fi_estimator")),
            Excerpt("by_failure", lambda row: row["setting"] == "fi"),
        ),
    ),
    "detector-faults": CampaignPage(
        "Faults in detectors",
        "A detector whose own memory or instructions are hit loses hardly a mission (1 of 1,600 faults in memory, "
        "none of 1,800 in instructions); up to 4.5 % fly more than 5 % longer after a needless recomputation. "
        "`gaussian_tuned` has the physics gate in front, into which its faults in memory are injected. Failures per "
        "flight hour: [models](../reference/models.md#failures-per-flight-hour).",
        {
            "detector_memory": ("by_target", "outcomes"),
            "detector_memory_others": ("by_target", "outcomes"),
            "detector_instructions": ("failures_per_hour",),
        },
        (
            Excerpt("detector_memory-by_target"),
            Excerpt("detector_memory_others-by_target", lambda row: row["target"] in WATCHING),
        ),
    ),
}
MODULES = {
    "leaderboard": "tools.build_leaderboard",
    "figures": "tools.draw_results",
    "golden-rates": "tools.golden_rates",
    "pictures": "tools.pictures",
    "speed": "benchmarks.run",
    "study": "tools.build_readme",
}
"""Modules that measure and write a page, by its name; each reads further options from the environment."""


def fly(campaign: str, scale: str = "paper") -> Path:
    """Fly a shipped campaign, or resume it; returns the folder of its ledger. "" = its only scale."""
    folder = Path("out") / campaign.replace("_", "-")
    command = [sys.executable, "-m", "mavfi", "campaign", "run", campaign, "--out", str(folder)]
    if scale:
        command += ["--scale", scale]
    subprocess.run(command, cwd=ROOT, check=True)
    return folder


def fly_bench(name: str, folder: Path) -> Path:
    """Fly a shipped bench at scale paper, or resume it; returns its folder."""
    command = [sys.executable, "-m", "mavfi", "bench", "detectors", name, "--scale", "paper", "--out", str(folder)]
    subprocess.run([*command, "--workers", str(os.cpu_count() or 1)], cwd=ROOT, check=True)
    return folder


def write_campaigns(name: str, ledgers: Mapping[str, Path]) -> Path:
    """Write the page of campaigns from their ledgers.

    Raises:
        BadInputError: A folder holds no ledger, or its runs have nothing to show in a view.
    """
    page = CAMPAIGNS[name]
    tables: dict[str, Table] = {}
    about: list[str] = []
    for campaign, views in page.campaigns.items():
        runs = load(ledgers[campaign])
        about += [" · ".join(header(runs.campaign))]
        prefix = ""
        if len(page.campaigns) > 1:
            prefix = f"{campaign}-"
        tables |= {f"{prefix}{view}": table(runs, view) for view in views}
    return write(name, page.title, page.text, tables, page.excerpts, about)


def main(arguments: Sequence[str]) -> int:
    """Write a page; returns the exit code."""
    names = sorted({*CAMPAIGNS, *MODULES})
    if not arguments or arguments[0] not in names:
        print(f"bad input: NAME: {' '.join(arguments) or 'not given'}; allowed: {', '.join(names)}", file=sys.stderr)
        return 2
    name, *rest = arguments
    if name in MODULES:
        sys.argv[1:] = rest
        runpy.run_module(MODULES[name], run_name="__main__", alter_sys=True)
        return 0
    try:
        page = write_campaigns(name, {campaign: fly(campaign) for campaign in CAMPAIGNS[name].campaigns})
    except BadInputError as error:
        print(f"bad input: {error}", file=sys.stderr)
        return 2
    except subprocess.CalledProcessError as error:
        return error.returncode
    print(f"wrote {page.relative_to(ROOT)}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
