"""Page and figure of the study of assumptions, from its stored rows."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mavfi.report import style
from mavfi.report.text import markdown_grid
from studies.assumptions.stored import stored_rows
from tools.markers import banner

COMMAND = "python -m studies.assumptions"
FIGURE = "assumptions.png"
ENVIRONMENTS = ("factory", "farm", "sparse", "dense")
NOT_REJECTED = 0.05
"""p from which on a reading is not rejected."""
_NONE_LOST = ", loses 0"
_INTERVAL = re.compile(r"([+-][\d.]+) \[([+-][\d.]+), ([+-][\d.]+)\]")

INTRODUCTION = """\
The paper's Table I can be read as two experiments. By the letter of its text, a fault is one bit of one executed
instruction. Most such faults change nothing, or kill a kernel whose node restarts; where one does lose a mission, it
seldom acts through the 13 values that the detectors watch, so the detectors bring nothing back. If the bit flips *in
one of these 13 values*, a fault costs about as much as in the paper, and the detectors can bring the missions back.
This study lists what paper and code leave open, flies the readings, fits them to the table's eight cells without
detectors, freezes the best, and compares their predictions with the eight cells with detectors."""

CONCLUSIONS = """\
**What the authors probably did.** They flipped bits of values between kernels, as section VI-D says of the second
platform, among those that their detectors watch, and an alarm recomputed more than control. Which bits were hit
remains open.

**What generalises.** A detector recovers what it watches and nothing else. When it acts, and what its alarm recomputes,
matter more than whether it is Gaussian or an autoencoder. With the recovery of the text (control again, way-point
abandoned) the autoencoder (AAD) brings back few missions; if its alarm recomputes the stage of the value that stands
out, it brings back all of them.

**What no reading explains.** That AAD recovers more than the Gaussian detector (GAD), and that Dense is hardest. Where
AAD brings all missions back, its recomputation costs more compute time than in the paper's Table II. The worst flight
times of Fig. 6 are not reached. That golden runs fail in Sparse and Dense needs a further cause, fitted by environment:
a *background* that loses missions with or without a fault, or a *time limit*, under which predictions are too wide to
reject much.

**What was decided beforehand.** The rule was to freeze and judge the best fit. That fit (any inter-kernel state, a time
limit) is rejected before correction for the number of combinations. Rules changed on the way: which readings stop; that
the best reading with faults in watched values is frozen as well; that each accepted account of the golden losses is
judged. After all choices, the reading was flown on other seeds ([study](study.md))."""


class StoredChange(NamedTuple):
    """What a change of one axis of an anchor does, as stored.

    Attributes:
        label: Value and anchor.
        points: Change of the success that one fault loses, by environment: value and 95 % interval (points).
    """

    label: str
    points: Mapping[str, tuple[float, float, float]]


def changes(rows: Sequence[Mapping[str, str]], environments: Sequence[str]) -> list[StoredChange]:
    """Single changes of the anchors, in the order of the rows.

    Raises:
        ValueError: A cell is not a value with an interval.
    """
    result = []
    for row in rows:
        points = {}
        for name in environments:
            match = _INTERVAL.fullmatch(row[name])
            if match is None:
                raise ValueError(f"{row['axis']}, {name}: {row[name]!r}")
            value, low, high = map(float, match.groups())
            points[name] = (value, low, high)
        result.append(StoredChange(f"{row['value']} ({row['anchor']})", points))
    return result


def figure_of(single_changes: Sequence[StoredChange]) -> Figure:
    """How much each single change moves what a fault loses: one row per change, one mark per environment."""
    figure = Figure(figsize=(9.2, 0.34 * len(single_changes) + 1.4), layout="constrained")
    axes: Axes = figure.subplots()
    colours = (style.BLUE, style.GREEN, style.AMBER, style.ORANGE)
    for row, change in enumerate(single_changes):
        looks = zip(change.points.items(), colours, "os^D", strict=False)
        for shift, ((name, (value, low, high)), colour, marker) in enumerate(looks):
            y = row + 0.16 * (shift - 1.5)
            axes.plot([low, high], [y, y], color=colour, linewidth=1.2, alpha=0.6)
            label = None
            if row == 0:
                label = name
            axes.plot(value, y, marker, color=colour, markersize=4.5, label=label)
    axes.axvline(0, color=style.GREY, linewidth=0.8)
    axes.set_yticks(range(len(single_changes)), [change.label for change in single_changes])
    axes.invert_yaxis()
    axes.set_xlabel("change of the success that one fault loses (points)")
    axes.legend(loc="lower right", frameon=False)
    return figure


def answer(folder: Path) -> list[str]:
    """The answer in a few sentences, from the rows in a folder."""
    counts = {row["readings"]: row["n"] for row in stored_rows("counts", folder)}
    combinations = stored_rows("detectors", folder)
    accepted = [row for row in combinations if float(row["holm"]) >= NOT_REJECTED]
    best = best_combination(combinations)
    fits = {row["reading"]: row for row in stored_rows("readings", folder)}
    fit = next(row for reading, row in fits.items() if _is_reading_of(reading, best))
    alike = [
        row["name"]
        for row in combinations
        if row["name"] != best["name"] and all(row[key] == best[key] for key in ("where", "losses", "deviance", "p"))
    ]
    outside = "all cells with detectors lie in its prediction intervals"
    if best["outside"] != "none":
        outside = f"outside its prediction intervals (paper - predicted, points): {best['outside']}"
    return [
        f"Of {counts['fitted']} readings ({counts['flown']} flown; the others count the same flights in another way) "
        f"{counts['not rejected']} agree with the cells without detectors at 5 %: these cells alone do not tell where "
        "the faults lay.",
        f"Of {len(combinations)} combinations with a reading of the detectors, judged on fresh seeds, {len(accepted)} "
        "are not rejected at 5 % (Holm).",
        f"The best (p = {float(best['p']):.2g}) has its faults in `{best['where']}` fields with `{best['losses']}` "
        f"losses and the detectors of `{best['name']}` (alike: {', '.join(alike) or 'none'}); {outside}. Its fit to "
        f"the cells without detectors: deviance {fit['deviance']}, {fit['freedom']} degrees of freedom, "
        f"p = {float(fit['p']):.2g}.",
    ]


def _is_reading_of(reading: str, combination: Mapping[str, str]) -> bool:
    """Whether a fitted reading is that of a judged combination."""
    values = reading.split(" (")[0].split(", ")
    return combination["where"] in values and combination["losses"] in values


def best_combination(combinations: Sequence[dict[str, str]]) -> dict[str, str]:
    """The combination that predicts the paper's cells with detectors best."""
    return max(combinations, key=lambda row: (float(row["p"]), -float(row["deviance"])))


def page(folder: Path, links: str, environments: Sequence[str] = ENVIRONMENTS) -> str:
    """The page, from the rows in a folder.

    Args:
        folder: Folder of the tables.
        links: The same folder, as the page links it.
        environments: Columns of the tables.
    """
    combinations = stored_rows("detectors", folder)
    losses = best_combination(combinations)["losses"]
    judged = [
        [
            row["where"],
            row["name"],
            row["gaussian"].removesuffix(_NONE_LOST),
            row["autoencoder"].removesuffix(_NONE_LOST),
            f"{float(row['holm']):.2g}",
        ]
        for row in combinations
        if row["losses"] == losses
    ]
    files = sorted(path.stem for path in folder.glob("*.csv"))
    differences = [
        [row["setting"], *(row[name] for name in environments)] for row in stored_rows("differences", folder)
    ]
    parts = [
        "# Which assumptions produce the paper's tables?",
        INTRODUCTION,
        "\n".join(f"- {sentence}" for sentence in answer(folder)),
        CONCLUSIONS,
        "## What a fault costs, and what the detectors bring back",
        "Success with the setting - success of golden runs, in points; in brackets the paper's.",
        markdown_grid(["", *environments], differences),
        "## Readings of the detectors, judged",
        f"Lost missions that the detectors bring back, with `{losses}` losses; p of the paper's eight cells.",
        markdown_grid(["faults", "detectors", "GAD brings back", "AAD brings back", "p (Holm)"], judged),
        "`text`: alarms act a step late, AAD recomputes control; `gate`: before the value is consumed; `code`: as the "
        "published code; `largest`: AAD recomputes the stage of the largest residual; `largest_own_worlds`: trained on "
        "these worlds; `predicted`: profile `tuned`.",
        "## Effect of each assumption",
        f"![Effect of each assumption]({FIGURE})",
        "All rows: " + ", ".join(f"[{name}]({links}/{name}.csv)" for name in files) + ". Method and columns: "
        "[the study](../../studies/assumptions/README.md).",
    ]
    return banner(COMMAND) + "\n\n".join(parts) + "\n"
