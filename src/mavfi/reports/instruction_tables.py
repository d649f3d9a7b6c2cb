"""The success table at instruction level, as the paper's Table I is, and the same by stage of the fault."""

from collections.abc import Iterable, Mapping
from typing import Any

from mavfi.campaign.kernel_success import END, POLICIES, RESTART
from mavfi.campaign.paper import INSTRUCTION_NOTE
from mavfi.reports import text
from mavfi.reports.table import Table

Analysis = Mapping[str, Any]
PAPER_NAMES = {
    "golden": "Golden run",
    "fi": "Injection run",
    "dr_gaussian": "Gaussian-based",
    "dr_autoencoder": "Autoencoder-based",
}
"""Rows of the paper's Table I."""
INSTRUCTION_LEVEL = "Instruction level, the paper's Table I: success rates, one fault per mission"
LABELS = {"": "here", RESTART: "here, node restarts", END: "here, mission ends"}
"""What is done about a kernel that crashes, hangs or raises."""
_DYING = (
    "node restarts / mission ends: what becomes of a mission whose kernel crashes, hangs or raises; the paper's ROS "
    "starts such nodes again; how many do is IR level, not machine level"
)
_RATES = "per cent, [95 % interval: Wilson, n reduced by the design effect of worlds], successes / n; bits of all kinds"


def instruction_tables(analysis: Analysis) -> list[Table]:
    """Tables of a campaign whose stages have equal numbers of faults in instructions; else none."""
    if analysis["campaign"]["kernels"]["share"] != "stage":
        return []
    return [_as_in_the_paper(analysis), _by_stage(analysis), _alarms(analysis)]


def _as_in_the_paper(analysis: Analysis) -> Table:
    """Settings by environments; below each the other policy, and the paper's figure."""
    entries = [entry for entry in analysis["success_by_policy"] if entry["stage"] == "all"]
    chosen = {(entry["setting"], entry["policy"], entry["environment"]): entry for entry in entries}
    environments = tuple(dict.fromkeys(entry["environment"] for entry in entries))
    settings = [name for name in dict.fromkeys(e["setting"] for e in entries) if not name.startswith("golden_")]
    rows = []
    for setting in settings:
        label = PAPER_NAMES.get(setting, setting)
        papers: list[float | None] = []
        for policy, name in LABELS.items():
            own = [chosen.get((setting, policy, environment)) for environment in environments]
            if any(own):
                rows.append((label, name, *map(text.rate, own)))
                papers = [None if entry is None else entry["paper"] for entry in own]
        if any(paper is not None for paper in papers):
            rows.append((label, "paper", *map(text.percent, papers)))
    notes = (
        INSTRUCTION_NOTE, "rates are conditional on one fault per mission", _estimand(analysis), _RATES, _DYING,
        *_missed(entries), *separable(analysis),
    )  # fmt: skip
    return Table(INSTRUCTION_LEVEL, ("", "", *environments), rows, notes)


def _estimand(analysis: Analysis) -> str:
    shares = "; ".join(f"{stage}: {', '.join(names)}" for stage, names in analysis["kernels"]["stages"].items())
    which = analysis["campaign"]["kernels"]["which"]
    drawn = "dynamic instructions" if which == "all" else f"dynamic instructions of class {which}"
    return (
        f"equal numbers of faults per stage, shared equally among its kernels ({shares}); within a kernel uniform over "
        f"its {drawn} in the golden flight, then over the bits of the value"
    )


def _missed(entries: Iterable[Mapping[str, Any]]) -> list[str]:
    """How many faults found nothing to strike, by setting; they stay in every rate."""
    counts: dict[str, list[int]] = {}
    for entry in entries:
        if entry["policy"] == RESTART:
            counts.setdefault(entry["setting"], []).append(entry["not_hit"])
    told = ", ".join(f"{setting} {sum(own)}" for setting, own in counts.items())
    missed = [f"faults that found no such call or did not hit, kept in every rate: {told}"]
    unknown = sum(entry["unknown"] for entry in entries if entry["policy"] != END)
    return missed + ([f"{unknown} flights could not be judged (unknown) and are left out"] if unknown else [])


def separable(analysis: Analysis) -> list[str]:
    """Which differences a success table cannot show, as a note; none where there is nothing to compare."""
    told = [
        f"{entry['environment']} {_points(entry['golden_fi'])} / {_points(entry['fi_dr'])}"
        for entry in analysis["separable"]
    ]
    if not told:
        return []
    return [
        "smaller differences, in points, are not told apart (golden – fi / fi – dr, power 80 %): " + "; ".join(told)
    ]


def _points(share: float | None) -> str:
    return text.ABSENT if share is None else f"{100 * share:.0f}"


def _by_stage(analysis: Analysis) -> Table:
    entries = [entry for entry in analysis["success_by_policy"] if entry["stage"] != "all"]
    rows = []
    by_policy = {(e["environment"], e["stage"], e["setting"], e["policy"]): e for e in entries}
    for entry in entries:
        if entry["policy"] == RESTART:
            key = entry["environment"], entry["stage"], entry["setting"]
            rates = (text.rate(by_policy.get((*key, policy))) for policy in POLICIES)
            rows.append((*key, *rates, str(entry["died"]), str(entry["not_hit"])))
    columns = (
        "environment",
        "stage",
        "setting",
        *(LABELS[p].removeprefix("here, ") for p in POLICIES),
        "died",
        "no hit",
    )
    notes = (_RATES, "died: kernels that crashed, hung or raised")
    return Table("Instruction level: success by stage of the fault", columns, rows, notes)


def _alarms(analysis: Analysis) -> Table:
    rows = [
        (entry["environment"], entry["setting"], text.rate(entry["consequence"])) for entry in analysis["detections"]
    ]
    notes = (
        "of the faults that hit; within 1 s an alarm of a state and instant that the golden flight with the same "
        "detector has not; most faults change nothing that is published, and there is nothing to see",
    )  # fmt: skip
    return Table("Alarms after a struck instruction", ("environment", "setting", "alarm within 1 s"), rows, notes)
