"""Tables of a report as plain text, derived from the analysis of a campaign; terminal and Markdown show the same."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from mavfi.campaign import paper
from mavfi.campaign.flights import ALL_BITS
from mavfi.faults.strata import HEADLINE
from mavfi.reports import text
from mavfi.reports.instruction_tables import PAPER_NAMES, instruction_tables, separable
from mavfi.reports.kernel_tables import kernel_tables
from mavfi.reports.table import Table

Analysis = Mapping[str, Any]
Entry = Mapping[str, Any]

DEVIATIONS = (
    "deviates from the published code: grace 1 s not 0, slow-down of the clock capped at 10, flight-controller limits, "
    "leg to the first point checked"
)
NOT_THE_PAPERS = "not the paper's: what a careful team would fly"
ONE_FAULT = "rates are conditional on one fault per mission"
HEALS = "a one-shot state fault heals on any recompute: recovery equals detection by construction"
HEALS_WITH_MEMORY = (
    "a recomputation begins with the memory that the stage had before its step: it heals what the step corrupted, not "
    "a map or a path that an earlier one did, nor a kernel that died"
)
VARIANT = paper.NOTE
STATE_LEVEL = "State level: success rates, one fault per mission"
SETTINGS = (
    "golden = no fault; fi = one fault; dr_X = the same faults with detector X on; golden_X = no fault, detector X on"
)
INTERVALS = (
    "per cent, [95 % interval: Wilson, n reduced by the design effect of worlds; whole word: MOVER over bit strata], n"
)


def tables(analysis: Analysis) -> list[Table]:
    """All tables that have rows, most important first; each says which stack flew."""
    of_kernels = analysis["campaign"]["law"] == "kernels"
    makers: tuple[Callable[[Analysis], Iterable[Table]], ...] = (
        as_in_the_paper, success, recovery, faults_by, outcomes, endings, flight_times, false_alarms, detections,
        overheads, sites,
    )  # fmt: skip
    if of_kernels:
        makers = (recovery, false_alarms, overheads) if analysis["campaign"]["detectors"] else ()
    found = _finished(analysis, (table for maker in makers for table in maker(analysis)))
    if not of_kernels:
        return found
    return [*_finished(analysis, instruction_tables(analysis)), *kernel_tables(analysis), *found]


def _finished(analysis: Analysis, found: Iterable[Table]) -> list[Table]:
    """Tables that have rows, with the stack and its deviations below."""
    stack = analysis["campaign"]["stack"]
    flew = {"published": DEVIATIONS, "hardened": NOT_THE_PAPERS}.get(stack, "")
    below = f"stack {stack}" + (f"; {flew}" if flew else "")
    return [
        Table(t.title, t.columns, _together(t.rows), (*t.notes, below), t.detail) for t in found if t.rows
    ]  # fmt: skip


def _together(rows: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Rows that begin with the same cell one below the other, in the order in which these cells first appear."""
    first = list(dict.fromkeys(row[0] for row in rows))
    return sorted(rows, key=lambda row: first.index(row[0]))


def _ordered(entries: Iterable[Entry], *keys: str) -> dict[tuple[Any, ...], list[Entry]]:
    groups: dict[tuple[Any, ...], list[Entry]] = {}
    for entry in entries:
        groups.setdefault(tuple(entry[key] for key in keys), []).append(entry)
    return groups


def populations_of(entries: Iterable[Entry]) -> list[str]:
    """Bit strata in the order in which reports show them: headline, whole word, the others."""
    found = dict.fromkeys(entry["population"] for entry in entries)
    order = (HEADLINE, "sign", "exponent", "whole_word", "mantissa")
    return sorted((name for name in found if name != "all"), key=lambda p: order.index(p) if p in order else len(order))


def as_in_the_paper(analysis: Analysis) -> Iterable[Table]:
    """Table I in the paper's layout: settings by environments, each with the paper's figure below."""
    if analysis["campaign"]["law"] != "stage_balanced":
        return
    chosen = {
        (entry["environment"], entry["setting"]): entry
        for entry in analysis["success"]
        if entry["population"] in ("all", HEADLINE)
    }
    environments = tuple(dict.fromkeys(environment for environment, _ in chosen))
    settings = [name for name in dict.fromkeys(setting for _, setting in chosen) if not name.startswith("golden_")]
    rows = []
    for setting in settings:
        entries = [chosen.get((environment, setting)) for environment in environments]
        label = PAPER_NAMES.get(setting, setting)
        rows.append((label, "here", *map(text.rate, entries)))
        papers = [entry["paper"] if entry else None for entry in entries]
        if any(paper is not None for paper in papers):
            rows.append((label, "paper", *map(text.percent, papers)))
    notes = (
        VARIANT, ONE_FAULT, "per cent, [95 % interval: Wilson, n reduced by the design effect of worlds], "
        "successes / n; faults in sign and exponent bits",
    )  # fmt: skip
    yield Table(STATE_LEVEL, ("", "", *environments), rows, (*notes, *separable(analysis)))


def success(analysis: Analysis) -> Iterable[Table]:
    """Success per environment and setting, beside the paper's figures."""
    entries = analysis["success"]
    populations = populations_of(entries)
    rows = []
    for (environment, setting), own in _ordered(entries, "environment", "setting").items():
        rates = {entry["population"]: text.rate(entry) for entry in own}
        first = rates.get("all", rates.get(populations[0], text.ABSENT) if populations else text.ABSENT)
        others = [rates.get(name, "") for name in populations[1:]]
        rows.append((environment, setting, first, text.percent(own[0]["paper"]), *others))
    first_heading = f"success %, {text.population(populations[0])}" if populations else "success %"
    columns = ("environment", "setting", first_heading, "paper", *map(text.population, populations[1:]))
    notes = [VARIANT, ONE_FAULT, SETTINGS, INTERVALS, "paper: instruction level, 100 golden flights, 300 with a fault"]
    unknown = sum(entry["unknown"] for entry in {(e["environment"], e["setting"]): e for e in entries}.values())
    if unknown:
        notes.append(f"{unknown} flights could not be judged (unknown) and are left out")
    yield Table("Success of missions", columns, rows, tuple(notes))


def recovery(analysis: Analysis) -> Iterable[Table]:
    """Recovery rate and McNemar's test of each arm; the cost of the faults themselves."""
    rows = []
    for entry in analysis["recovery"]:
        found, test = entry["recovery"], entry["mcnemar"]
        told = text.ABSENT
        if found is not None:
            told = "undefined" if found["rate"] is None else (
                f"{text.percent(found['rate'])} {text.interval(found['low'], found['high'])} "
                f"{found['regained']}/{found['lost']}"
            )  # fmt: skip
        loss = text.ABSENT if found is None else (
            f"{100 * found['loss']:+.1f} {text.interval(found['loss_low'], found['loss_high'])}"
        )  # fmt: skip
        rows.append((
            entry["environment"], entry["setting"], text.population(entry["population"]), told,
            text.percent(entry["paper"]) if entry["population"] in (HEADLINE, ALL_BITS) else "", loss, str(test["n"]),
            f"{test['first_only']} / {test['second_only']}", f"{test['p_value']:.3g}",
        ))  # fmt: skip
    columns = (
        "environment", "setting", "bits", "recovery", "paper", "golden – fi (points)", "pairs", "fi / dr only", "p",
    )  # fmt: skip
    notes = (
        "recovery = (dr – fi) / (golden – fi), [exact binomial interval], regained / lost missions; undefined while "
        "the interval of golden – fi contains 0",
        HEALS_WITH_MEMORY if analysis["campaign"]["law"] == "kernels" else HEALS,
        "golden – fi: in pairs, MOVER interval from the shares of pairs in which only one succeeds",
        "fi / dr only: pairs in which only that one succeeds; p: McNemar's exact test", ONE_FAULT,
    )  # fmt: skip
    yield Table("Recovery", columns, rows, notes)
    pairs = [
        (e["environment"], text.population(e["population"]), str(e["n"]), str(e["first_only"]), str(e["second_only"]),
         f"{e['p_value']:.3g}")
        for e in analysis["golden_against_faults"]
    ]  # fmt: skip
    headings = ("environment", "bits", "pairs", "only golden succeeds", "only fi succeeds", "p")
    yield Table("Golden against one fault, in pairs", headings, pairs, ("p: McNemar's exact test", ONE_FAULT))


FEWEST = 10
"""Flights from which a field has a row in the report; all are in summary.json."""
_BY = (
    ("by_stage", "stage", "Success by stage of the fault"),
    ("by_target", "target", "Success by group of fields"),
    ("by_state", "state", "Success by inter-kernel state"),
    ("by_bits", "bits", "Success by class of the flipped bit"),
    ("by_field", "field", "Success by field"),
)


def faults_by(analysis: Analysis) -> Iterable[Table]:
    """Success by properties of the fault: over all environments in the terminal, each environment in the file."""
    groups = analysis["campaign"]["law"] == "groups"
    for key, name, title in _BY:
        if (key == "by_target" and not groups) or (key == "by_stage" and groups):
            continue
        entries = analysis[key]
        environments = list(dict.fromkeys(entry["environment"] for entry in entries))
        for environment in environments:
            own = [entry for entry in entries if entry["environment"] == environment]
            whole = environment == "all" or len(environments) == 1
            where = "" if environment == "all" else f", {environment}"
            yield _success_by(own, name, f"{title}{where}", detail=not whole or key == "by_field")


def _success_by(entries: list[Entry], name: str, title: str, detail: bool) -> Table:
    populations = populations_of(entries)
    rows = []
    for (value, setting), own in _ordered(entries, name, "setting").items():
        by_population = {entry["population"]: entry for entry in own}
        if name == "field" and sum(e["n"] for p, e in by_population.items() if p != "whole_word") < FEWEST:
            continue
        shown = populations[0] if populations[0] in by_population else own[0]["population"]
        hurt = by_population[shown]["fails_or_slower"]
        cells = [text.rate(by_population[p]) if p in by_population else text.ABSENT for p in populations]
        worst = text.signed_percent(by_population[shown]["worst_inflation"])
        rows.append((value, setting, *cells, f"{text.percent(hurt['rate'])}", worst))
    columns = (name, "setting", *map(text.population, populations), "hurt", "worst time")
    notes = (
        f"success: {INTERVALS}",
        f"hurt: fails or takes more than 5 % longer than the golden twin; worst time of successes; both for "
        f"{text.population(populations[0])}",
        ONE_FAULT,
        *((f"fields with fewer than {FEWEST} flights are in summary.json only",) if name == "field" else ()),
    )
    return Table(title, columns, rows, notes, detail)


_OUTCOMES = {"masked": "masked", "sdc": "sdc", "sdc_alarmed": "(alarm)", "due": "due", "unknown": "unknown"}
_FATES = ("hit", "no_site", "not_hit")


def outcomes(analysis: Analysis) -> Iterable[Table]:
    """What faults did to the computation, and where they went."""
    notes = (
        "masked = bit for bit the golden twin; sdc = the flight differs from the golden twin's, silent for the mission "
        "computer unless a detector is on; of these, alarm = raised on the struck publication; due = died or hung",
        "no site: the golden flight never published the state; not hit: the injected flight did not; both are kept in "
        "every rate (intention to treat)",
    )
    headings = ("n", *_OUTCOMES.values(), *(fate.replace("_", " ") for fate in _FATES))
    for keys, detail in ((("environment", "setting"), False), (("environment", "setting", "stage"), True)):
        rows = []
        for values, own in _ordered(analysis["outcomes"], *keys).items():
            counts = (str(sum(entry[name] for entry in own)) for name in ("n", *_OUTCOMES, *_FATES))
            rows.append((*values, *counts))
        title = "Outcomes of faults" + (", by stage" if detail else "")
        yield Table(title, (*keys, *headings), rows, notes, detail)


def endings(analysis: Analysis) -> Iterable[Table]:
    """How missions ended."""
    statuses = list(dict.fromkeys(name for entry in analysis["endings"] for name in entry["statuses"]))
    rows = [
        (e["environment"], e["setting"], str(e["n"]), *(str(e["statuses"].get(name, 0)) for name in statuses))
        for e in analysis["endings"]
    ]
    headings = (name.replace("_", " ") for name in statuses)
    yield Table("How missions ended", ("environment", "setting", "n", *headings), rows)


def flight_times(analysis: Analysis) -> Iterable[Table]:
    """Flight time against the golden twin, and golden flights themselves."""
    rows = []
    for e in analysis["flight_times"]:
        time, energy = e["time"] or {}, e["energy"] or {}
        rows.append((
            e["environment"], e["setting"], str(e["pairs"]), text.signed_percent(time.get("median")),
            text.signed_percent(time.get("p95")), text.signed_percent(time.get("worst")),
            text.signed_percent(e["paper_worst"]), text.number(e["time_limit_s"], 0, "s"),
            text.signed_percent(energy.get("worst")), f"{e['censored']}/{e['n']}",
        ))  # fmt: skip
    columns = (
        "environment", "setting", "pairs", "median", "95 %", "worst", "paper's worst", "limit", "worst energy", "fail",
    )  # fmt: skip
    notes = (
        "flight time / that of the golden flight of the same world – 1, on pairs that succeed in all settings; "
        "failures have no flight time, see the last column",
        "the time limit bounds the worst case; the paper recovers percentage points of its worst case", ONE_FAULT,
    )  # fmt: skip
    yield Table("Flight time", columns, rows, notes)
    medians = [
        (e["environment"], e["setting"], str(e["n"]), text.number(e["flight_time_s"], 1, "s"),
         text.number(e["energy_j"] / 1000, 1, "kJ"), text.number(e["distance_m"], 1, "m"), f"{e['replans']:g}")
        for e in analysis["golden"]
    ]  # fmt: skip
    headings = ("environment", "setting", "n", "flight time", "energy", "distance", "replans")
    yield Table("Golden flights that succeed, medians", headings, medians)


def false_alarms(analysis: Analysis) -> Iterable[Table]:
    """Alarms on golden flights."""
    rows = []
    for e in analysis["false_alarms"]:
        per_hour = text.ABSENT if e["per_hour"] is None else f"{e['per_hour']:.1f} [{e['low']:.1f}, {e['high']:.1f}]"
        # "source/action/outcome"; the source is in the name of the setting
        kinds = ", ".join(f"{' '.join(kind.split('/')[1:])} {count}" for kind, count in e["kinds"].items())
        rows.append((
            e["environment"], e["setting"], str(e["flights"]), str(e["flights_with_alarm"]), str(e["events"]),
            str(sum(alarm["flights"] for alarm in e["systematic"])), f"{e['hours']:.2f} h", per_hour,
            text.number(e["upper"]), kinds,
        ))  # fmt: skip
    columns = (
        "environment", "setting", "flights", "with alarm", "alarms", "systematic", "exposure", "per hour",
        "upper bound", "kinds",
    )  # fmt: skip
    always = {(a["state"], a["time_s"]) for e in analysis["false_alarms"] for a in e["systematic"]}
    notes = (
        "golden flights; per hour of flight, 95 % interval: bootstrap of flights, at least as wide as Poisson's, which "
        "alone is left where there is no alarm; upper bound: one-sided 95 %",
        "systematic: same state and instant in more than 90 % of the flights"
        + "".join(f"; {state} at {time_s:.2f} s" for state, time_s in sorted(always)),
    )
    yield Table("False alarms", columns, rows, notes)


def detections(analysis: Analysis) -> Iterable[Table]:
    """Faults that hit, and alarms on what was struck."""
    rows = [
        (e["environment"], e["setting"], text.population(e["population"]), "yes" if e["monitored"] else "no",
         text.rate(e), text.rate(e["consequence"]))
        for e in analysis["detections"]
    ]  # fmt: skip
    columns = ("environment", "setting", "bits", "field watched", "detected", "consequence detected")
    notes = (
        HEALS, "detected: alarm on the struck publication, before it is seen; coupling inline: the latency is 0 by "
        "construction", "consequence detected: within 1 s, an alarm of a state and instant that the golden flight with "
        "the same detector has not; false alarms that the fault has shifted are among them",
    )  # fmt: skip
    yield Table("Detection of faults that hit", columns, rows, notes, True)


def overheads(analysis: Analysis) -> Iterable[Table]:
    """Recomputation against the compute time of the pipeline."""
    rows = []
    for e in analysis["overheads"]:
        if e["setting"].startswith("null"):
            continue
        stages = [text.small_percent(e["recompute"][stage]) for stage in ("perception", "planning", "control")]
        paper = e["paper"] or {}
        beside = " / ".join(text.small_percent(paper[stage]) for stage in paper) or text.ABSENT
        total = text.small_percent(e["total"])
        rows.append((e["environment"], e["setting"], str(e["flights"]), *stages, total, beside))
    columns = ("environment", "setting", "flights", "perception", "planning", "control", "total", "paper (stages)")
    notes = ("recomputation / compute time of the pipeline, both in the platform's modelled time; nothing was measured "
             "on that hardware",)  # fmt: skip
    yield Table("Overhead of recomputation", columns, rows, notes)


def sites(analysis: Analysis) -> Iterable[Table]:
    """Failures at fields that no detector watches; publications that nobody acts on; the null runs."""
    watched = analysis["campaign"]["monitored_set"]
    rows = [(e["environment"], str(e["n"]), text.rate({**e, "successes": e["unmonitored"]}))
            for e in analysis["unmonitored_failures"]]  # fmt: skip
    columns = ("environment", "failures (fi)", "at unmonitored sites")
    yield Table("Failures at sites that no detector watches", columns, rows, (f"monitored set {watched}",))
    shares = [
        (e["environment"], e["state"], str(e["publications"]), str(e["acted_on"]),
         text.percent(e["acted_on"] / e["publications"] if e["publications"] else None, 2))
        for e in analysis["acted_on"]
    ]  # fmt: skip
    headings = ("environment", "state", "publications", "acted on", "share")
    notes = ("golden flights; faults on this state strike only publications that consumers act on",)
    yield Table("Publications that consumers act on", headings, shares, notes)
