"""Tables of faults in instructions as plain text."""

from collections.abc import Iterable, Mapping
from typing import Any

from mavfi.campaign.paper import KERNELS_SUCCESS_LOSS, KERNELS_WORST_TIME
from mavfi.reports import text
from mavfi.reports.table import Table

Entry = Mapping[str, Any]
LEVEL = "SDC rates are quoted; crash, hang and exception rates are IR level, not machine level"
POLICIES = (
    "after a crash, hang or exception: restart = the node is there again after the restart latency with fresh memory; "
    "end = the mission has failed"
)
WEIGHTED = (
    "drawn by value class and source line: rates are weighted back to uniform dynamic instructions; counts, times and "
    "sizes of errors are of flights as drawn"
)
OUTCOMES = (
    "masked: what the kernel publishes and remembers is bit for bit the golden; sdc: it is not; intervals: 95 %, "
    "Wilson, n reduced by the design effect of worlds"
)


def kernel_tables(analysis: Mapping[str, Any]) -> list[Table]:
    """All tables of a kernel campaign that have rows, most important first."""
    kernels = analysis["kernels"]
    replayable, all_runs = kernels["replayable"]
    note = f"{replayable} of {all_runs} flights can be replayed bit for bit"
    if replayable < all_runs:
        note += (
            ": where an address or a branch was struck, only those flown in processes with fixed addresses, which this "
            "system did not allow"
        )
    stack = f"stack {analysis['campaign']['stack']}"
    found = (_outcomes(kernels, note), _missions(kernels), *_splits(kernels), _errors(kernels))
    weights = (WEIGHTED,) if kernels.get("weighted") else ()
    return [Table(t.title, t.columns, t.rows, (*t.notes, *weights, stack), t.detail) for t in found if t.rows]


def _outcomes(kernels: Entry, note: str) -> Table:
    rows = [
        (entry["environment"], entry["kernel"], str(entry["n"]), *map(text.rate, _three(entry)), _due(entry))
        for entry in kernels["table"]
    ]
    columns = ("environment", "kernel", "n", "masked", "sdc", "due", "crash / hang / exc.")
    return Table("One fault in one instruction: what the kernel did", columns, rows, (OUTCOMES, LEVEL, note))


def _three(entry: Entry) -> Iterable[Entry]:
    return (entry[name] for name in ("masked", "sdc", "due"))


def _due(entry: Entry) -> str:
    return " / ".join(str(entry["counts"].get(name, 0)) for name in ("crash", "hang", "exception"))


def _missions(kernels: Entry) -> Table:
    rows = []
    for entry in kernels["table"]:
        time = (text.signed_percent(entry["time"][name]) for name in ("median", "p95", "worst"))
        rates = (entry[name] for name in ("golden", "success_given_sdc", "success_restart", "success_ended"))
        changed = text.percent(entry["flight_changed"]["rate"])
        paper = entry["paper"] or text.ABSENT
        rows.append((entry["environment"], entry["kernel"], *map(text.rate, rates), changed, *time, paper))
    columns = (
        "environment", "kernel", "golden", "success | sdc", "success, restart", "success, end", "changed", "median",
        "p95", "worst", "paper's Fig. 3",
    )  # fmt: skip
    notes = (
        POLICIES,
        "changed: flights that are not bit for bit their golden twin; median, p95, worst: flight time against the "
        "golden twin, where both arrive",
        "the paper's Fig. 3 (Sparse, 100 runs per kernel) has no numbers to read off; its text: flight time up to "
        f"{text.signed_percent(KERNELS_WORST_TIME)}, success lower by up to {100 * KERNELS_SUCCESS_LOSS:.0f} points, "
        "both in planning and control",
    )  # fmt: skip
    return Table("One fault in one instruction: what became of the mission", columns, rows, notes)


def _splits(kernels: Entry) -> Iterable[Table]:
    for key, name, title in (
        ("by_value_class", "value_class", "by value class"),
        ("by_stratum", "stratum", "by bit: sign, exponent, mantissa"),
    ):
        rows = [
            (
                entry["kernel"], str(entry[name]).replace("_", " ") or text.ABSENT, str(entry["n"]),
                *map(text.rate, _three(entry)), text.rate(entry["success_given_sdc"]),
                text.signed_percent(entry["time"]["worst"]),
            )
            for entry in kernels[key]
        ]  # fmt: skip
        columns = ("kernel", name.replace("_", " "), "n", "masked", "sdc", "due", "success | sdc", "worst time")
        notes = (
            LEVEL,
            "other: bits of integers, addresses and conditions; a result of one bit has no sign or exponent",
        )
        yield Table(f"Outcomes {title}", columns, rows, notes)


def _errors(kernels: Entry) -> Table:
    rows = []
    for entry in kernels["errors"]:
        sizes = (_size(entry[name]) for name in ("elements", "size", "largest"))
        counts = (str(entry[name]) for name in ("not_finite", "flight_changed"))
        where = f"{entry['state']} {entry['field']}".strip()
        share = text.percent(entry["share"])
        rows.append((entry["kernel"], where, str(entry["n"]), share, *sizes, *counts, text.rate(entry["success"])))
    columns = (
        "kernel", "first differing field", "sdc", "share", "elements", "median size", "largest", "not finite",
        "changed", "success",
    )  # fmt: skip
    notes = (
        "which silent corruptions within a kernel become which errors between kernels: state-level faults strike one "
        "element of one field, uniformly over its bits",
        "elements: in how many places the field differs (median); size: largest difference in the field's unit",
        "(memory only): nothing published differs at once, but what the kernel remembers does",
    )
    return Table("From instruction to inter-kernel state", columns, rows, notes)


def _size(value: float | None) -> str:
    return text.ABSENT if value is None else f"{value:.3g}"
