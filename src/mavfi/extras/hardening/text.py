"""Hardening advice and certificates as sentences and tables."""

from mavfi.analysis.rows import KERNEL_DUE
from mavfi.analysis.statistics import Rate
from mavfi.analysis.table import Table
from mavfi.extras.hardening.certification import TOLERANCE, Certification
from mavfi.extras.hardening.certify import CONFIRMED, REFUTED, RESOLVED, UNDECIDED, UNKNOWN, Certificate, Unprotected
from mavfi.extras.hardening.summary import AdviceSummary
from mavfi.report.text import ABSENT, percent

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
_CERTIFICATE = (
    "kernel", "function", "SDC before", "SDC after", "detected", "DUE after", "instr.", "time", "SDCs removed",
    "predicted", "", "pairs",
)  # fmt: skip


def headline(summary: AdviceSummary) -> str:
    """The advice in one sentence."""
    protected = [row.kernel for row in summary.kernels if row.added > 0 or row.coverage.rate]
    if not protected:
        return f"Nothing can be protected within {percent(summary.budget)} of a flight's kernel time."
    if summary.complete:
        corruptions = "all silent corruptions (SDC)"
    else:
        corruptions = f"the silent corruptions (SDC) in {', '.join(row.kernel for row in summary.kernels)}"
    return (
        f"Protect {', '.join(protected)}: {percent(summary.spent)} more kernel time per flight removes "
        f"{interval(summary.coverage)} of {corruptions}, predicted from {summary.injections:,} injections."
    )


def caveats(summary: AdviceSummary) -> list[str]:
    """What the protection does not buy."""
    silent, dead = summary.harm.silent, summary.harm.dead
    return [
        f"It does not buy missions: {silent.successes} of {silent.n} flights with an SDC were lost, "
        f"{interval(silent)}; {dead.successes} of {dead.n} with a dead kernel.",
        f"It does not buy crashes: {interval(summary.harm.dead_share)} of the injections ended in a crash, hang or "
        "exception; duplication detects some of them at IR level, which says nothing about machine level.",
    ]


def advice_table(summary: AdviceSummary) -> Table:
    """What to protect, by function; the last column is left out if nothing has been certified."""
    rows: list[tuple[str, ...]] = []
    for row in summary.functions:
        certified = ABSENT if row.certified is None else interval(row.certified)
        rows.append((
            row.kernel, row.entry, percent(row.share), f"×{row.time:.2f}", percent(row.added, 2),
            interval(row.coverage), str(row.coverage.n), f"{row.sites} of {row.all_sites}", certified,
        ))  # fmt: skip
    columns: tuple[str, ...] = _ADVICE
    if all(row.certified is None for row in summary.functions):
        columns = _ADVICE[:-1]
        rows = [row[:-1] for row in rows]
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
    said = "" if foreseen.rate is None else f" (predicted with the same weights: {interval(foreseen)})"
    alone = verdicts.count(REFUTED)
    corrected = f" ({certification.wrong} with Holm's correction for so many)" if alone else ""
    return (
        f"The plan is {outcome}: {interval(certification.coverage)} of {counted} are removed, on fresh missions and "
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


def _certificate_row(one: Certificate) -> tuple[str, ...]:
    n = sum(one.after.values())
    return (
        one.kernel, one.function.rpartition(".")[2], interval(one.sdc_before), interval(one.sdc_after),
        percent(one.after.get("detected", 0) / n), percent(sum(one.after.get(name, 0) for name in KERNEL_DUE) / n),
        f"×{one.growth:.2f}", _time(one), interval(one.coverage), interval(one.predicted_rate), one.verdict,
        f"{one.paired.first_only} : {one.paired.second_only}, p = {one.paired.p_value:.2g}",
    )  # fmt: skip


def _time(one: Certificate) -> str:
    """Time ratio as measured, with that of the plan."""
    return ABSENT if one.time is None else f"×{one.time:.2f} (×{one.planned_time:.2f})"


def _unprotected_row(one: Unprotected) -> tuple[str, ...]:
    known = (one.kernel, one.function.rpartition(".")[2], interval(one.sdc))
    row = dict.fromkeys(_CERTIFICATE, ABSENT) | dict(zip(_CERTIFICATE, known, strict=False)) | {"": "not duplicated"}
    return tuple(row.values())


def interval(rate: Rate) -> str:
    """A rate with its interval, in per cent: "93.1 % [90.2, 95.4]"."""
    if rate.rate is None or rate.low is None or rate.high is None:
        return ABSENT
    return f"{percent(rate.rate)} [{100 * rate.low:.1f}, {100 * rate.high:.1f}]"
