"""Hardening advice and certificates as sentences and tables."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from mavfi.campaign.analysis.rows import KERNEL_DUE
from mavfi.campaign.analysis.statistics import Rate
from mavfi.campaign.analysis.table import Table
from mavfi.campaign.hardening.battery import DETECTED, SDC
from mavfi.campaign.hardening.certification import Certification
from mavfi.campaign.hardening.certify import CONFIRMED, REFUTED, RESOLVED, UNDECIDED, UNKNOWN, Certificate, Unprotected
from mavfi.campaign.hardening.spending import TOLERANCE
from mavfi.campaign.hardening.ways import CUT
from mavfi.reports.text import ABSENT, percent

_ADVICE = (
    "kernel",
    "function",
    "kernel time",
    "time",
    "adds",
    "SDCs removed, predicted",
    "n SDC",
    "sites",
    "certified",
)
_TWICE = 2.0
_SIGNIFICANT = 0.01
NAMES = {CUT: "minimum cut", "line": "by source line", "opcode": "by opcode", "random": "at random"}
"""Ways to choose, for readers."""
_MACHINE = ("kernel", "function", "code", "n", "SDC", "crash", "hang, exception", "detected", "instr.")
_CERTIFICATE = (
    "kernel", "function", "SDC before", "SDC after", "detected", "DUE after", "instr.", "time", "SDCs removed",
    "predicted", "", "pairs",
)  # fmt: skip


def headline(summary: Mapping[str, Any]) -> str:
    """The advice in one sentence."""
    named = [row["kernel"] for row in summary["kernels"] if row["added"] > 0 or row["coverage"]["rate"]]
    if not named:
        return f"Nothing can be protected within {percent(summary['budget'])} of a flight's kernel time."
    every = "all silent corruptions (SDC)"
    some = f"the silent corruptions (SDC) in {', '.join(row['kernel'] for row in summary['kernels'])}"
    return (
        f"Protect {', '.join(named)}: {percent(summary['spent'])} more kernel time per flight removes "
        f"{interval(summary['coverage'])} of {every if summary['complete'] else some}, predicted from "
        f"{summary['injections']:,} injections."
    )


def caveats(summary: Mapping[str, Any]) -> list[str]:
    """What the protection does not buy."""
    harm = summary["harm"]
    silent, dead, share = (harm[name] for name in ("silent", "dead", "dead_share"))
    return [
        f"It does not buy missions: {silent['successes']} of {silent['n']} flights with an SDC were lost, "
        f"{interval(silent)}; {dead['successes']} of {dead['n']} with a dead kernel.",
        f"It does not buy crashes: {interval(share)} of the injections ended in a crash, hang or exception; "
        "duplication detects some of them at IR level, which says nothing about machine level.",
    ]


def certified(row: Mapping[str, Any]) -> str:
    """Certified coverage of a function, as text."""
    return ABSENT if row["certified"] is None else interval(row["certified"])


def rerun_line(summary: Mapping[str, Any]) -> str:
    """Why calls are not computed twice instead: twice the time, at least, for all of the silent corruptions."""
    rows = [row for row in summary["functions"] if row["steps"][-1]["time"] > _TWICE]
    text = "Computing a whole call twice (kind rerun) removes all SDCs, but takes at least ×2.00: "
    if not rows:
        return f"{text}every function here is duplicated in full for less."
    named = [
        f"{row['entry']} (×{row['steps'][-1]['time']:.2f} in full; a rerun adds at least {percent(row['share'])} of a "
        f"flight's kernel time, the budget is {percent(summary['budget'])})"
        for row in rows
    ]
    return f"{text}less than full duplication for {', '.join(named)} only."


def ways_line(summary: Mapping[str, Any]) -> str:
    """How often the minimum cut removes significantly more, or fewer, SDCs than simpler ways to choose."""
    compared = [one for row in summary["functions"] for one in row["ways"]]
    counts = []
    for way, name in list(NAMES.items())[1:]:
        clear = [one["coverage"] for one in compared if one["p"][way] < _SIGNIFICANT]
        more = sum(found[CUT]["rate"] > found[way]["rate"] for found in clear)
        counts.append(f"than {name} in {more}, fewer in {len(clear) - more}")
    return (
        f"In {len(compared)} comparisons of a function at a cost, the minimum cut removes more SDCs "
        f"{'; '.join(counts)} (p < {_SIGNIFICANT}, McNemar's test)."
    )


def advice_table(summary: Mapping[str, Any]) -> Table:
    """What to protect, by function."""
    rows: list[tuple[str, ...]] = [
        (
            row["kernel"], row["entry"], percent(row["share"]), f"×{row['time']:.2f}", percent(row["added"], 2),
            interval(row["coverage"]), str(row["coverage"]["n"]), f"{row['sites']} of {row['all_sites']}",
            certified(row),
        )
        for row in summary["functions"]
    ]  # fmt: skip
    known = any(row["certified"] for row in summary["functions"])
    columns, rows = (_ADVICE, rows) if known else (_ADVICE[:-1], [row[:-1] for row in rows])
    notes = (
        "kernel time: share of a golden flight's; time: measured, protected / plain; adds: of a flight's kernel time; "
        "predicted by cross-validation over recorded calls, 95 % interval; sites: instructions that are "
        "duplicated, of those that can be",
    )
    return Table.of_text("What to protect", columns, rows, notes)


def verdict_line(certification: Certification) -> str:
    """The certificate in one sentence."""
    golden = certification.golden
    verdicts = [one.verdict for one in certification.certificates if one.verdict != UNKNOWN]
    judged = UNDECIDED if certification.verdict == UNDECIDED else CONFIRMED
    outcome = REFUTED if certification.refuted else judged if verdicts else "measured; it has no prediction"
    scope = certification.scope
    counted = f"the SDCs in {', '.join(scope)}" if scope else "all SDCs"
    foreseen = certification.predicted
    said = "" if foreseen.rate is None else f" (predicted with the same weights: {interval_of(foreseen)})"
    alone = verdicts.count(REFUTED)
    corrected = f" ({certification.wrong} with Holm's correction for so many)" if alone else ""
    return (
        f"The plan is {outcome}: {interval_of(certification.coverage)} of {counted} are removed, on fresh missions and "
        f"faults{said}; {alone} of {len(verdicts)} predictions are refuted{corrected}, "
        f"{verdicts.count(UNDECIDED)} undecided; golden digests equal in {golden.same} of {golden.flights} flights; "
        f"{golden.alarms} false alarms in {golden.calls:,} calls{_spent(certification)}."
    )


def _spent(certification: Certification) -> str:
    """What the plan adds to the flights to which it adds most, and whether that is too much."""
    if not certification.spending:
        return ""
    most = max(certification.spending, key=lambda one: (one.refuted, one.measured))
    known = "" if most.budget is None else f"; the budget is {percent(most.budget)}"
    outcome = f", more than {percent(TOLERANCE)} beyond it: refuted" if most.refuted else ""
    return (
        f"; it adds {percent(most.measured)} of a flight's kernel time (with the plan's times: {percent(most.planned)}"
        f"{known}){outcome}"
    )


def certificate_tables(certification: Certification) -> list[Table]:
    """All tables of a certificate."""
    machine = [machine_table(certification)] if certification.machine else []
    return [certificate_table(certification), *machine]


def certificate_table(certification: Certification) -> Table:
    """Certificates by function."""
    rows = [_certificate_row(one) for one in certification.certificates]
    rows += [_unprotected_row(one) for one in certification.others]
    notes = (
        f"{certification.faults} faults per function in plain code, as many in protected code, uniform over its own "
        "dynamic instructions; SDCs removed: 1 - SDC after x instr. / SDC before, so that added instructions do not "
        "dilute the rate; instr.: dynamic instructions, protected / plain; time: "
        "the same for time, measured here (in the plan)",
        "DUE (crash, hang, exception) at IR level; pairs: of the faults in plain code, injected once more in protected "
        "code: SDC in plain code only : in protected code only, McNemar's test",
        "undecided: the interval of measured - predicted coverage contains 0, but is wider than "
        f"±{100 * RESOLVED:.0f} points, so that other predictions would pass as well; more faults would help",
        *(f"flights with {one.planner}: adds {percent(one.measured)} of their kernel time (with the plan's times: "
          f"{percent(one.planned)})" for one in certification.spending),
    )  # fmt: skip
    return Table.of_text("Certificate", _CERTIFICATE, rows, notes)


def machine_table(certification: Certification) -> Table:
    """Register faults at machine level, in plain and in protected code of a function."""
    rows = []
    for one in certification.machine:
        columns = [one.rates(SDC), one.rates("crash"), one.rates("hang", "exception"), one.rates(DETECTED)]
        for place, (code, sites) in enumerate((("plain", one.sites), ("protected", one.protected_sites))):
            rates = [rates[place] for rates in columns]
            name = one.function.rpartition(".")[2]
            rows.append((one.kernel, name, code, str(rates[0].n), *map(interval_of, rates), f"{sites:,}"))
    notes = [
        "one bit of a destination register in one single-stepped call of each function, a fresh one; instr.: executed "
        "machine instructions with such a register, over which faults are uniform",
        *(f"{one.function.rpartition('.')[2]}: {interval_of(one.coverage)} of the SDCs per call removed at machine "
          "level: 1 - SDC protected x instr. protected / (SDC plain x instr. plain)" for one in certification.machine),
    ]  # fmt: skip
    return Table.of_text("Machine level", _MACHINE, rows, notes)


def _certificate_row(one: Certificate) -> tuple[str, ...]:
    n = sum(one.after.values())
    return (
        one.kernel, one.function.rpartition(".")[2], interval_of(one.sdc_before), interval_of(one.sdc_after),
        percent(one.after.get("detected", 0) / n), percent(sum(one.after.get(name, 0) for name in KERNEL_DUE) / n),
        f"×{one.growth:.2f}", _time(one), interval_of(one.coverage), interval_of(one.predicted_rate), one.verdict,
        f"{one.paired.first_only} : {one.paired.second_only}, p = {one.paired.p_value:.2g}",
    )  # fmt: skip


def _time(one: Certificate) -> str:
    """Time ratio as measured, with that of the plan."""
    return ABSENT if one.time is None else f"×{one.time:.2f} (×{one.planned_time:.2f})"


def _unprotected_row(one: Unprotected) -> tuple[str, ...]:
    known = (one.kernel, one.function.rpartition(".")[2], interval_of(one.sdc))
    row = dict.fromkeys(_CERTIFICATE, ABSENT) | dict(zip(_CERTIFICATE, known, strict=False)) | {"": "not duplicated"}
    return tuple(row.values())


def interval_of(found: Rate) -> str:
    """A rate with its interval, in per cent."""
    return interval(asdict(found))


def interval(found: Mapping[str, Any]) -> str:
    """A rate with its interval, in per cent: "93.1 % [90.2, 95.4]"."""
    if found["rate"] is None:
        return ABSENT
    return f"{percent(found['rate'])} [{100 * found['low']:.1f}, {100 * found['high']:.1f}]"
