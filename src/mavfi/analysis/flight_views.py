"""Views of campaigns with flights: success, recovery, success by fault property, effects, endings, alarms, kernels."""

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import polars as pl

from mavfi.analysis import measures as m
from mavfi.analysis import published as paper
from mavfi.analysis.measures import Measure
from mavfi.analysis.rows import ACTIVATED, ALL_BITS, KERNEL_DUE, NO_SITE, NOT_ACTIVATED, POPULATIONS
from mavfi.analysis.runs import ALL, Runs
from mavfi.analysis.statistics import Rate, Recovery
from mavfi.analysis.table import NUMBER, PER_HOUR, PERCENT, POINTS, RATE, TEXT
from mavfi.analysis.views import View, has
from mavfi.campaign.plan import FI
from mavfi.plugins import Chapter

ONE_FAULT = "rates are conditional on one fault per mission"
_WILSON = "per cent, [95 % interval: Wilson, n reduced by the design effect of worlds"
INTERVALS = f"{_WILSON}], n"
_STRATA_INTERVALS = f"{_WILSON}; whole word: MOVER over bit strata], n"
_SETTINGS = (
    "golden = no fault; fi = one fault; dr_X = the same faults with detector X on; golden_X = no fault, detector X on"
)
HEALS = "a one-shot state fault heals on any recompute: recovery equals detection by construction"
_HEALS_WITH_MEMORY = (
    "a recomputation begins with the memory that the stage had before its step: it heals what the step corrupted, not "
    "a map or a path that an earlier one did, nor a kernel that died"
)
_SHIFTED = (
    "a fault names its call by number: after a false alarm, which repeats calls, it is in another value with the "
    "detector than without; such pairs are in brought back and in newly lost alike"
)
STATE = "state"
MEMORY = "memory"
INSTRUCTION = "instruction"
SENSOR = "sensor"
TOTAL = ("environment", ALL)
SETTING = ("environment", "setting")


def conditional_on(runs: Runs) -> str:
    """The note on the number of faults in each mission."""
    return f"rates are conditional on {runs.per_mission} per mission"


# ---- applicability -----------------------------------------------------------------------------------------------
def of_states(runs: Runs) -> bool:
    """Whether faults in inter-kernel states were injected."""
    return has(runs.injected, level=STATE)


def of_sensors(runs: Runs) -> bool:
    """Whether sensors or motors failed."""
    return has(runs.injected, level=SENSOR)


def of_values(runs: Runs) -> bool:
    """Whether faults were injected into inter-kernel states or kernel memory."""
    return of_states(runs) or has(runs.injected, level=MEMORY)


def _by_stages(runs: Runs) -> bool:
    return len(runs.injected.where(pl.col("target") == pl.col("stage"), level=STATE)) > 0


def _by_groups(runs: Runs) -> bool:
    return len(runs.injected.where(pl.col("target") != pl.col("stage"), pl.col("level").is_in((STATE, MEMORY)))) > 0


def watched(runs: Runs) -> bool:
    """Whether any flight has a detector."""
    return len(runs.where(pl.col("detector") != "")) > 0 and runs.has_missions


# ---- success -----------------------------------------------------------------------------------------------------
def unknown_note(runs: Runs) -> list[str]:
    """Note with the number of flights that could not be judged; none if all were."""
    unknown = len(runs.where(~pl.col("judged")))
    if not unknown:
        return []
    return [f"{unknown} flights could not be judged (unknown) and are left out"]


def separable_note(runs: Runs) -> list[str]:
    """Note with the smallest differences that a success table can resolve."""
    parts = [f"{each.environment} {_points(each.golden_fi)} / {_points(each.fi_dr)}" for each in m.separable(runs)]
    if not parts:
        return []
    start = "smaller differences, in points, are not distinguished (golden – fi / fi – dr, power 80 %): "
    return [start + "; ".join(parts)]


def _points(share: float | None) -> str:
    if share is None:
        return "—"
    return f"{100 * min(share, 1.0):.0f}"


def of_missions(runs: Runs) -> Runs:
    """All runs except null runs."""
    return runs.where(pl.col("kind") != "null")


def faulty_and_bare(runs: Runs) -> Runs:
    """Golden runs without a detector and all injected runs, labelled with the row names of the paper's table."""
    names = {
        "golden": "Golden run",
        "fi": "Injection run",
        "dr_gaussian": "Gaussian-based",
        "dr_autoencoder": "Autoencoder-based",
    }
    faulty_or_bare = of_missions(runs).where((pl.col("kind") == "injected") | (pl.col("arm") == ""))
    return faulty_or_bare.adding(row=pl.col("setting").replace(names))


NO_FAULT = "no fault"
"""Row of the flights without a fault, in a table by group."""
NO_DETECTOR = "no detector"


def _golden_and_groups(runs: Runs) -> Runs:
    """All runs except null runs, labelled with their group of fields and with their arm."""
    group = pl.when(pl.col("kind") == "golden").then(pl.lit(NO_FAULT)).otherwise(pl.col("target"))
    arm = pl.when(pl.col("arm") == "").then(pl.lit(NO_DETECTOR)).otherwise(pl.col("arm"))
    return of_missions(runs).where("judged").adding(group=group, row_arm=arm)


def _bits_drawn(runs: Runs) -> str:
    """The bits that the faults of a success table are in."""
    if ALL_BITS in m.population_names(runs, ()):
        return "all bits, as drawn"
    return "sign and exponent bits"


def _papers_counts(runs: Runs) -> list[str]:
    """The note on the paper's column, if there is one."""
    if paper.compared(runs.campaign):
        return ["paper: instruction level, 100 golden flights, 300 with a fault"]
    return []


_SUCCESS = (
    View(
        "success_as_in_the_paper",
        "State level: success rates, one fault per mission",
        ("row",),
        (
            Measure(
                "here",
                "here",
                RATE,
                lambda runs: m.leading_rate(runs, m.population_names(runs, ()), "success"),
                counted=lambda runs: m.leading_runs(runs, m.population_names(runs, ())),
            ),
            paper.column(paper.success),
        ),
        where=faulty_and_bare,
        across="environment",
        headings=("",),
        notes=lambda runs: (
            paper.level_note(runs, paper.STATE_LEVEL),
            ONE_FAULT,
            "per cent, [95 % interval: Wilson, n reduced by the design effect of "
            f"worlds], successes / n; faults in {_bits_drawn(runs)}",
            *separable_note(runs),
        ),
        leads=True,
        applies=_by_stages,
    ),
    View(
        "success_by_group",
        "Success of missions by group of fields, %",
        ("environment", "group"),
        (Measure("success", "", RATE, lambda runs: m.rate_of(runs, "success")),),
        where=_golden_and_groups,
        across="row_arm",
        notes=lambda runs: (
            conditional_on(runs),
            f"{INTERVALS}; faults in the bits that the campaign draws: by kind of bit with --view by_target",
            *unknown_note(of_missions(runs)),
        ),
        leads=True,
        applies=lambda runs: _by_groups(runs) and runs.campaign.get("each") == "group",
    ),
    View(
        "success",
        "Success of missions",
        SETTING,
        (m.leading_success, paper.column(paper.success), m.other_success),
        where=of_missions,
        notes=lambda runs: (
            paper.level_note(runs, paper.STATE_LEVEL),
            ONE_FAULT,
            _SETTINGS,
            _STRATA_INTERVALS,
            *_papers_counts(runs),
            *unknown_note(of_missions(runs)),
        ),
        leads=True,
        applies=of_states,
    ),
    View(
        "memory_success",
        "Success of missions, faults in memory",
        SETTING,
        (m.leading_success, m.other_success),
        where=of_missions,
        notes=lambda runs: (conditional_on(runs), _SETTINGS, _STRATA_INTERVALS, *unknown_note(of_missions(runs))),
        leads=True,
        applies=lambda runs: has(runs.injected, level=MEMORY),
    ),
)


# ---- recovery ----------------------------------------------------------------------------------------------------
def _recovery(cell_of: Callable[[Runs, Recovery], Any]) -> Callable[[Runs], Any]:
    """A measure of the recovery rate of a group; its cell is empty without pairs."""

    def cell(runs: Runs) -> Any:
        recovery = m.recovery_of(runs)
        if recovery is None:
            return None
        return cell_of(runs, recovery)

    return cell


NO_ESTIMATE = "no estimate"
"""Recovery rate whose denominator may be 0."""


def _recovery_rate(_: Runs, recovery: Recovery) -> Any:
    if recovery.rate.rate is None:
        return NO_ESTIMATE
    return recovery.rate


def _papers_recovery(runs: Runs) -> float | None:
    if runs.first("population") not in m.COMPARED or runs.first("level") == MEMORY:
        return None
    if not paper.comparable(runs):
        return None
    return paper.recovery(runs.first("environment"), runs.first("setting"))


def named_populations(runs: Runs) -> Runs:
    """Sort runs by population, and add the column `bits` with its display name."""
    ranks = {name: rank for rank, name in enumerate(POPULATIONS)}
    rank = pl.col("population").replace_strict(ranks, default=len(ranks), return_dtype=pl.Int64)
    named = runs.frame.with_columns(bits=pl.col("population").replace(POPULATIONS))
    return replace(runs, frame=named.sort(rank, maintain_order=True))


def _recovery_notes(runs: Runs) -> list[str]:
    """Notes below a table of recovery: its terms, tests and intervals."""
    notes = [
        "lost: missions that succeed without the fault and fail with it; brought back: of these, those that "
        "succeed with the detector on; newly lost / saved: missions that fail / succeed only with the detector on",
        f"p: {m.PAIRED_TEST}; newly lost against saved by the detector",
        f"recovery = (dr – fi) / (golden – fi), [exact binomial interval]; {NO_ESTIMATE} while the interval of "
        "golden – fi contains 0; below 0 where more missions are newly lost than brought back",
    ]
    if of_states(runs):
        notes.append(HEALS)
    else:
        notes.append(_HEALS_WITH_MEMORY)
    if has(runs.injected, level=INSTRUCTION):
        notes.append(_SHIFTED)
    notes += [
        "golden – fi: in pairs, MOVER interval from the shares of pairs in which only one succeeds",
        conditional_on(runs),
    ]
    return notes


_RECOVERY = (
    View(
        "recovery",
        "Recovery",
        ("environment", "bits", "setting"),
        (
            m.count("pairs", "pairs"),
            Measure("lost", "lost", NUMBER, _recovery(lambda _, recovery: recovery.lost)),
            Measure("brought_back", "brought back", NUMBER, _recovery(lambda _, recovery: recovery.regained)),
            Measure("newly_lost", "newly lost", NUMBER, lambda runs: m.discordant(runs).first_only),
            Measure("only_dr", "saved", NUMBER, lambda runs: m.discordant(runs).second_only),
            Measure("p", "p", "number .3g", lambda runs: m.discordant(runs).p_value),
            Measure("recovery", "recovery", "percent with interval", _recovery(_recovery_rate)),
            paper.beside(Measure("paper", "paper", PERCENT, _papers_recovery)),
            Measure(
                "loss",
                "golden – fault (points)",
                POINTS,
                _recovery(
                    lambda runs, recovery: Rate(len(runs), recovery.loss.value, recovery.loss.low, recovery.loss.high)
                ),
            ),
        ),
        where=lambda runs: named_populations(m.against_fi(runs)),
        total=TOTAL,
        notes=_recovery_notes,
        applies=lambda runs: len(runs.settings()) > 1 and runs.has_missions,
    ),
)


# ---- success by properties of the fault --------------------------------------------------------------------------
MIN_FLIGHTS = 10  # minimum number of flights for a field to have a row in the report


_HURT = "hurt: fails or takes more than 5 % longer than the golden run; worst time of successes"


def _by(name: str, title: str, by: tuple[str, ...], **options: Any) -> View:
    """A table of success by properties of the fault and by setting; `options` replace those for faults in states."""
    notes = (f"success, hurt: {_STRATA_INTERVALS}", f"{_HURT}; both for the first column's bits", ONE_FAULT)
    defaults = {
        "applies": of_states,
        "measures": (m.leading_success, m.other_success, m.hurt),
        "notes": lambda _: notes,
    }
    levels = pl.col("level").is_in((STATE, MEMORY, SENSOR))
    return View(
        name,
        title,
        (*by, "setting"),
        where=lambda runs: runs.injected.where("judged", levels),
        **{**defaults, **options},
    )


_OF_FAILURES: dict[str, Any] = {
    "applies": of_sensors,
    "measures": (Measure("success", "success %", RATE, lambda runs: m.rate_of(runs, "success")), m.hurt),
    "notes": lambda _: (f"success, hurt: {INTERVALS}", _HURT, ONE_FAULT),
}
_UNIT = "Success by failing sensor or motor"
_BY_PROPERTY = (
    _by("by_stage", "Success by stage of the fault", ("stage",), applies=_by_stages),
    _by("by_target", "Success by group of fields", ("target",), applies=_by_groups),
    _by("by_state", "Success by inter-kernel state", ("state",)),
    _by("by_unit", _UNIT, ("state",), **_OF_FAILURES, headings=("unit", "setting")),
    _by(
        "by_unit_and_environment",
        f"{_UNIT}, each environment",
        ("environment", "state"),
        **{**_OF_FAILURES, "applies": lambda runs: of_sensors(runs) and len(runs.values("environment")) > 1},
        headings=("environment", "unit", "setting"),
    ),
    _by("by_failure", "Success by type of failure", ("field",), **_OF_FAILURES, headings=("type", "setting")),
    _by("by_bits", "Success by class of the flipped bit", ("bit_class",), applies=of_values),
    _by("by_field", f"Success by field, {MIN_FLIGHTS} flights or more", ("state", "field"), least=MIN_FLIGHTS),
)


# ---- effects and endings -----------------------------------------------------------------------------------------
_EFFECTS = (
    m.count("n", "n"),
    m.count("masked", "masked", effect="masked"),
    m.count("sdc", "sdc", effect="sdc"),
    m.count("sdc_alarmed", "(alarm)", "detected_at_site", effect="sdc"),
    m.count("due", "died", pl.col("effect").is_in(KERNEL_DUE)),
    m.count("unknown", "unknown", effect="unknown"),
    m.count("activated", "activated", site_outcome=ACTIVATED),
    m.count("no_site", "no site", site_outcome=NO_SITE),
    m.count("not_activated", "not activated", site_outcome=NOT_ACTIVATED),
)
_EFFECT_NOTES = (
    "masked = bit for bit the golden run; sdc = the flight differs from the golden run, silent for the mission "
    "computer unless a detector is on or a kernel died; of these, alarm = raised on the corrupted publication; died = "
    "its process crashed, hung or raised",
    "no site: the golden flight never published the state; not activated: the injected flight did not; both are "
    "kept in every rate (intention to treat)",
)


def _statuses(runs: Runs, _: tuple[str, ...]) -> Any:
    for status in runs.values("status"):
        yield m.count(status, status.replace("_", " "), status=status)


_ENDS = (
    View(
        "outcomes",
        "Effects of faults",
        SETTING,
        _EFFECTS,
        where=lambda runs: runs.injected,
        notes=lambda _: _EFFECT_NOTES,
        applies=of_values,
    ),
    View(
        "endings",
        "How missions ended",
        SETTING,
        (m.count("n", "n"), _statuses),
        where=of_missions,
        applies=of_values,
    ),
)


# ---- flight time -------------------------------------------------------------------------------------------------
def paired(runs: Runs) -> Runs:
    """Judged injected runs, with column `paired`: the mission succeeds with this fault in every setting."""
    pair = ("environment", "target", "index")
    succeeds = pl.col("inflation").is_not_null().all().over(pair)
    settings = pl.col("setting").n_unique().over("environment")
    return runs.injected.where("judged").adding(paired=(pl.len().over(pair) == settings) & succeeds)


FLIGHTS = Chapter(10, (*_SUCCESS, *_RECOVERY, *_BY_PROPERTY, *_ENDS))


# ---- alarms ------------------------------------------------------------------------------------------------------
def _golden_watched(runs: Runs) -> Runs:
    return runs.golden.where(pl.col("detector") != "", end="flown")


def _kinds(runs: Runs) -> str:
    kinds: Counter[str] = Counter()
    for record in runs.recorded():
        kinds.update(record.alarm_counts)
    # "source/action/outcome"; the name of the setting already contains the source
    return ", ".join(f"{' '.join(kind.split('/')[1:])} {count}" for kind, count in kinds.items())


def _systematic_note(runs: Runs) -> str:
    parts = _golden_watched(runs).groups("setting", "environment").values()
    always = {(alarm.state, alarm.time_s) for flights in parts for alarm in m.systematic(flights)}
    alarms = "".join(f"; {state} at {time_s:.2f} s" for state, time_s in sorted(always))
    return f"systematic: same state and instant in more than 90 % of the flights{alarms}"


def _monitored_note(runs: Runs) -> str:
    name = runs.campaign.get("monitored_set", "")
    return (
        f"monitored set {name}: the fields that the paper's detectors see; others watch more (the acceptance test "
        "every field of the states with a rule), and may catch faults outside it"
    )


def _detected(runs: Runs) -> Runs:
    activated = runs.injected.where("judged", pl.col("detector") != "", site_outcome=ACTIVATED)
    in_set = pl.when(pl.col("monitored")).then(pl.lit("yes")).otherwise(pl.lit("no"))
    return named_populations(activated).adding(in_monitored_set=in_set)


ALARMS = Chapter(
    30,
    (
        View(
            "false_alarms",
            "False alarms",
            SETTING,
            (
                m.count("flights", "flights"),
                m.count("with_alarm", "with alarm", pl.col("alarms_total") > 0),
                Measure("alarms", "alarms", NUMBER, lambda runs: sum(runs["alarms_total"])),
                Measure(
                    "systematic", "systematic", NUMBER, lambda runs: sum(alarm.flights for alarm in m.systematic(runs))
                ),
                Measure("hours", "exposure", "number .2f h", lambda runs: sum(runs["flight_time_s"]) / 3600),
                Measure("per_hour", "per hour", PER_HOUR, m.alarm_rate),
                Measure("upper", "upper bound", "number .1f", lambda runs: m.alarm_rate(runs).upper),
                Measure("kinds", "kinds", TEXT, _kinds),
            ),
            where=_golden_watched,
            total=TOTAL,
            notes=lambda runs: (
                "golden flights; per hour of flight, 95 % interval: bootstrap of flights, at least as wide as "
                "Poisson's, which alone is left where there is no alarm; upper bound: one-sided 95 %",
                _systematic_note(runs),
            ),
            applies=watched,
        ),
        View(
            "detections",
            "Detection of activated faults",
            ("environment", "setting", "bits", "in_monitored_set"),
            (
                m.rate("detected", "detected", "detected_at_site"),
                m.rate("downstream", "detected downstream", "detected_downstream"),
            ),
            where=_detected,
            notes=lambda runs: (
                HEALS,
                _monitored_note(runs),
                "detected: alarm on the corrupted publication; with coupling inline before it is seen, so the latency "
                "is 0 by construction",
                "detected downstream: within 1 s, an alarm of a state and instant that the golden flight with the same "
                "detector has not; false alarms that the fault has shifted are among them",
            ),
            applies=lambda runs: of_states(runs) and watched(runs),
        ),
    ),
)


_DYING = (
    "node restarts / mission ends: what becomes of a mission whose kernel crashes, hangs or raises; the paper's ROS "
    "starts such nodes again; the share of kernels that die is measured in LLVM IR, not machine code"
)
_RATES = "per cent, [95 % interval: Wilson, n reduced by the design effect of worlds], successes / n; bits of all kinds"
_LEVEL = "SDC rates may be quoted; crash, hang and exception rates are measured in LLVM IR, not machine code"
_EFFECT_NOTE = (
    "masked: what the kernel publishes and remembers is bit for bit the golden; sdc: it is not; intervals: 95 %, "
    "Wilson, n reduced by the design effect of worlds"
)


def _of_instructions(runs: Runs) -> bool:
    return has(runs.injected, level=INSTRUCTION)


# ---- success under both policies ---------------------------------------------------------------------------------
def _success_of(kind: str, column: str) -> Callable[[Runs], Any]:
    """Share of judged runs of a kind for which a column is true; None for groups of another kind."""

    def cell(runs: Runs) -> Any:
        if runs.first("kind") != kind:
            return None
        return m.rate_of(runs.where("judged"), column)

    return cell


def _estimand(runs: Runs) -> str:
    """The population of which the rates are estimates, as a note."""
    planned = {name: rank for rank, name in enumerate(runs.campaign.get("kernels", ()))}
    stages = runs.injected.where(level=INSTRUCTION).groups("stage")
    kernels = {
        stage: sorted(part.values("kernel"), key=lambda name: planned.get(name, len(planned)))
        for (stage,), part in stages.items()
    }
    shares = "; ".join(f"{stage or 'detector'}: {', '.join(names)}" for stage, names in kernels.items())
    without = planned.keys() - set(runs.injected.values("kernel"))
    if without:
        shares += f"; no fault in {', '.join(sorted(without))}"
    which = runs.campaign.get("which", "all")
    drawn = "dynamic instructions"
    if which != "all":
        drawn = f"dynamic instructions of class {which}"
    return (
        f"equal numbers of faults per stage, shared equally among its kernels ({shares}); within a kernel uniform over "
        f"its {drawn} in the golden flight, then over the bits of the value"
    )


def _missed_note(runs: Runs) -> str:
    parts = runs.injected.where("judged").groups("setting")
    missed = pl.col("site_outcome") != ACTIVATED
    counts = ", ".join(f"{setting} {len(part.where(missed))}" for (setting,), part in parts.items())
    return f"faults that found no such call or were not activated, kept in every rate: {counts}"


def _instruction_title(runs: Runs) -> str:
    """The title of the table of success, which is the paper's Table I only if the same was flown."""
    level = "Instruction level"
    if paper.compared(runs.campaign):
        level = f"{level}, the paper's Table I"
    return f"{level}: success rates, one fault per mission"


_KERNEL_SUCCESS = (
    View(
        "instructions_as_in_the_paper",
        _instruction_title,
        ("row",),
        (
            Measure("here", "here", RATE, _success_of("golden", "success")),
            Measure("restart", "here, node restarts", RATE, _success_of("injected", "success")),
            Measure("end", "here, mission ends", RATE, _success_of("injected", "success_if_ended")),
            paper.column(paper.success),
        ),
        where=faulty_and_bare,
        across="environment",
        headings=("",),
        notes=lambda runs: (
            paper.level_note(runs, paper.INSTRUCTION_LEVEL),
            ONE_FAULT,
            _estimand(runs),
            _RATES,
            _DYING,
            _missed_note(runs),
            *unknown_note(faulty_and_bare(runs)),
            *separable_note(runs),
        ),
        leads=True,
        # equal numbers of faults per stage: rates over all faults are comparable with the paper's table
        applies=lambda runs: _of_instructions(runs) and runs.campaign.get("each") == "stage",
    ),
)


# ---- effects on kernels ------------------------------------------------------------------------------------------
def kernel_runs(runs: Runs) -> Runs:
    """Runs in setting `fi` with an instruction fault, of which the effects on kernel and flight are known."""
    return _all_settings(runs).where(setting=FI)


def _all_settings(runs: Runs) -> Runs:
    """As `kernel_runs`, of all settings."""
    judged = (pl.col("kernel_effect") != "") & (pl.col("effect") != "unknown")
    return runs.injected.where(judged, level=INSTRUCTION)


def _effect(*effects: str) -> pl.Expr:
    return pl.col("kernel_effect").is_in(effects)


_MASKED_SDC_DUE = (
    m.rate("masked", "masked", _effect("masked")),
    m.rate("sdc", "sdc", _effect("sdc")),
    m.rate("due", "died", _effect(*KERNEL_DUE)),
)
_DETECTED = _effect("detected")


def _replayable_note(runs: Runs) -> str:
    flights = kernel_runs(runs)
    replayable = len(flights.where("replayable"))
    note = f"{replayable} of {len(flights)} flights can be replayed bit for bit"
    if replayable == len(flights):
        return note
    return f"{note}: not those with a corrupted address or branch in a kernel whose memory belongs to a library"


_KERNEL_EFFECTS = (
    View(
        "kernel_effects",
        "One fault in one instruction: what the kernel did",
        ("environment", "kernel"),
        (
            m.count("n", "n"),
            *_MASKED_SDC_DUE,
            Measure(
                "due_kinds",
                "crash / hang / exc.",
                TEXT,
                lambda runs: " / ".join(str(len(runs.where(kernel_effect=name))) for name in KERNEL_DUE),
            ),
        ),
        where=kernel_runs,
        notes=lambda runs: (_EFFECT_NOTE, _LEVEL, _replayable_note(runs)),
        applies=_of_instructions,
    ),
    View(
        "kernel_effects_by_setting",
        "One fault in one instruction of a kernel, plain and protected",
        ("environment", "kernel", "setting"),
        (
            m.count("n", "n"),
            *_MASKED_SDC_DUE,
            m.rate("found", "detected", _DETECTED),
            m.rate("success", "success", "success"),
            m.rate("success_due", "success | died", "success", _effect(*KERNEL_DUE)),
        ),
        where=lambda runs: _all_settings(runs).where(site_outcome=ACTIVATED),
        notes=lambda _: (
            _EFFECT_NOTE,
            "detected: by protected code, whose call is computed again; died: crash, hang or exception",
            "n: faults that were activated; protected kernels take longer, so that the same call number meets other "
            "values, or none: settings are compared as samples, not in pairs",
            _LEVEL,
        ),
        applies=lambda runs: _of_instructions(runs) and len(_all_settings(runs).where(_DETECTED)) > 0,
    ),
)
KERNELS = Chapter(70, (*_KERNEL_SUCCESS, *_KERNEL_EFFECTS))
