"""Tables of the study of assumptions, from its flights."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import polars as pl

from mavfi.analysis import published as paper
from mavfi.analysis.measures import recomputed_share
from mavfi.analysis.rows import ALL_BITS
from mavfi.analysis.runs import Runs
from mavfi.extras.paper.claims import (
    AS_PUBLISHED,
    CLAIMS,
    CONFIRMED,
    CONTRADICTED,
    INSTRUCTIONS,
    KERNELS,
    UNDECIDED,
    VALUES,
    Claim,
    holm,
    verdict,
)
from mavfi.report.text import short
from studies.assumptions.design import INSTRUCTION, STATE, PaperReading
from studies.assumptions.fit import (
    Counts,
    EnvironmentFlights,
    PointsDifference,
    deviance_interval,
    lost_points,
    paper_counts,
)
from studies.assumptions.rounds import (
    NOT_REJECTED,
    AssumptionResults,
    FrozenReading,
    JudgedDetectors,
    fit_of,
)
from studies.assumptions.stored import StoredTable

_SHOWN = 12
"""Rows of the table of readings."""
_SHORT = {"dr_gaussian": "GAD", "dr_autoencoder": "AAD"}
"""The paper's names of its detectors, by setting."""
_LISTED = 4
"""Readings that a cell names; of more it gives the number."""
_OUT_OF_REACH = {
    "III-B": "needs faults in one named state at a time (Fig. 4), see the study of the paper",
    "VI-C": "no assumption bears on it: time of detection on their machine, or a calibrated model",
    "VI-D": "no assumption bears on it: another computer",
}
"""What would bear on a finding that no reading of this study does, by section of the paper."""


def tables(results: AssumptionResults) -> list[StoredTable]:
    """All tables, the answer first."""
    return [
        counts_table(results),
        differences_table(results),
        cells_table(results),
        detectors_table(results),
        axes_table(results),
        readings_table(results),
        findings_table(results),
        worst_times_table(results),
        ledgers_table(results),
    ]


# ---- the answer ------------------------------------------------------------------------------------------------------
class Combination(NamedTuple):
    """A frozen reading of the faults with a reading of the detectors."""

    frozen: FrozenReading
    detectors: JudgedDetectors
    corrected_p: float

    @property
    def name(self) -> str:
        """E.g. "monitored, background, with largest"."""
        reading = self.frozen.fitted.reading
        return f"{reading['where']}, {reading['losses']}, with {self.detectors.name}"


def combinations_of(results: AssumptionResults) -> list[Combination]:
    """All judged combinations, with p after Holm's correction over all of them."""
    pairs = [(frozen, item) for frozen in results.frozen for item in frozen.detectors]
    corrected = holm([item.judgement.p_value for _, item in pairs])
    return [Combination(*pair, p if p is not None else 1.0) for pair, p in zip(pairs, corrected, strict=True)]


def best_combination(results: AssumptionResults) -> Combination:
    """The combination that predicts the paper's detector cells best."""

    def quality(combination: Combination) -> tuple[float, float]:
        judgement = combination.detectors.judgement
        return judgement.p_value, -judgement.deviance

    return max(combinations_of(results), key=quality)


def counts_table(results: AssumptionResults) -> StoredTable:
    """How many readings were fitted, flown, and not rejected by the cells without detectors."""
    accepted = [item for item in results.fitted if item.fit.p_value >= NOT_REJECTED]
    rows = [("fitted", len(results.fitted)), ("flown", len(results.flown)), ("not rejected", len(accepted))]
    return StoredTable("counts", ("readings", "n"), rows)


def _cells_outside(item: JudgedDetectors) -> str:
    """Cells of the paper outside their prediction interval, with paper - predicted (points)."""
    cells = []
    for (environment, setting), cell in item.judgement.cells.items():
        if not cell.low <= cell.paper <= cell.high:
            cells.append(f"{_SHORT[setting]} {environment} {100 * (cell.paper - cell.mean):+.1f}")
    return ", ".join(cells)


def cells_table(results: AssumptionResults) -> StoredTable:
    """The paper's Table I beside the best combination."""
    best = best_combination(results)
    rows: list[tuple[object, ...]] = []
    for name in results.study.environments:
        golden, faulty = (_counts(results, best.frozen, name, setting).rate for setting in ("golden", "fi"))
        rows.append((name, "golden run", paper_counts(name, "golden").rate, golden, "", "fitted"))
        rows.append((name, "one fault", paper_counts(name, "fi").rate, faulty, "", "fitted"))
        for setting, words in _SHORT.items():
            cell = best.detectors.judgement.cells[name, setting]
            interval = f"[{100 * cell.low:.1f}, {100 * cell.high:.1f}]"
            rows.append((name, words, cell.paper, cell.mean, interval, "predicted"))
    columns = ("environment", "setting", "paper", "here", "interval", "status")
    return StoredTable("cells", columns, rows)


def differences_table(results: AssumptionResults) -> StoredTable:
    """Differences to the golden run in points, in the paper and here, which no background enters."""
    best = best_combination(results)
    rows = []
    for setting, words in (("fi", "one fault"), ("dr_gaussian", "with GAD"), ("dr_autoencoder", "with AAD")):
        cells = [words]
        for name in results.study.environments:
            papers = 100 * (paper_counts(name, setting).rate - paper_counts(name, "golden").rate)
            here = _setting_of(results, best, setting)
            ours = lost_points(best.frozen.flights[name], here, _deaths(results, best.frozen))
            cells.append(f"{-ours.points:+z.1f} ({papers:+z.1f})")
        rows.append(tuple(cells))
    columns = ("setting", *results.study.environments)
    return StoredTable("differences", columns, rows)


def _setting_of(results: AssumptionResults, best: Combination, papers: str) -> str:
    """Our setting for a setting of the paper."""
    if papers == "fi":
        return papers
    return f"dr_{results.study.arm_of(best.detectors.name, papers.removeprefix('dr_'))}"


def _counts(results: AssumptionResults, frozen: FrozenReading, environment: str, setting: str) -> Counts:
    """Counts of golden runs, or of those with a fault, in an environment, as the frozen reading counts them."""
    losses = results.study.value("losses", frozen.fitted.reading["losses"]).losses
    fitted = frozen.fitted.fit.environments[environment].best
    flights = frozen.flights[environment]
    limit_s = np.inf
    if losses == "time_limit":
        limit_s = fitted
    if setting == "golden":
        counts = flights.golden.counts(limit_s=limit_s)
    else:
        counts = flights.faulty[setting].counts(_deaths(results, frozen), limit_s)
    if losses == "background":
        return Counts(fitted * counts.successes, counts.n)
    return counts


def _deaths(results: AssumptionResults, frozen: FrozenReading) -> str:
    """How a frozen reading counts dead kernels."""
    return results.study.value("deaths", frozen.fitted.reading["deaths"]).deaths


def detectors_table(results: AssumptionResults) -> StoredTable:
    """The judged combinations."""
    rows = []
    for combination in combinations_of(results):
        item = combination.detectors
        brought = [_brought_back(item, setting) for setting in _SHORT]
        rows.append(
            (
                combination.frozen.fitted.reading["where"],
                combination.frozen.fitted.reading["losses"],
                item.name,
                *brought,
                item.judgement.deviance,
                item.judgement.p_value,
                combination.corrected_p,
                _cells_outside(item) or "none",
            )
        )
    columns = ("where", "losses", "name", "gaussian", "autoencoder", "deviance", "p", "holm", "outside")
    return StoredTable("detectors", columns, rows)


def _brought_back(item: JudgedDetectors, setting: str) -> str:
    """E.g. "66 of 87, loses 1"."""
    rows = item.runs.injected.where("judged").frame
    pair = ("environment", "target", "index")
    bare = rows.filter(setting="fi").select(*pair, fault="success")
    watched = rows.filter(setting=setting).select(*pair, saved="success")
    both = bare.join(watched, on=pair)
    lost = both.filter(~both["fault"])
    newly_lost = both.filter(both["fault"] & ~both["saved"]).height
    return f"{int(lost['saved'].sum())} of {lost.height}, loses {newly_lost}"


# ---- axes and readings -----------------------------------------------------------------------------------------------
class ChangeEffect(NamedTuple):
    """What a change of one axis of an anchor does.

    Attributes:
        anchor: Name of the anchor.
        axis: Name of the axis.
        value: Name of its value.
        points: AxisChange of the success lost to a fault, by environment, in points.
        golden: Success of golden runs, by environment, after the change.
        deviance: AxisChange of the deviance, each reading with the background that fits it best.
    """

    anchor: str
    axis: str
    value: str
    points: Mapping[str, PointsDifference]
    golden: Sequence[float]
    deviance: float

    @property
    def largest(self) -> float:
        """Largest change over environments (points)."""
        return max(abs(change.points) for change in self.points.values())


def effects(results: AssumptionResults) -> list[ChangeEffect]:
    """Effects of all single changes of the anchors, the largest first."""
    study = results.study
    lost = {}

    def lost_by(reading: PaperReading) -> Mapping[str, PointsDifference]:
        if reading not in lost:
            flights = results.flown[study.flights_of(reading)].flights
            deaths = study.value("deaths", reading["deaths"]).deaths
            lost[reading] = {name: lost_points(part, "fi", deaths) for name, part in flights.items()}
        return lost[reading]

    all_effects = []
    for reading, changes in results.changes.items():
        for change in changes:
            anchor = study.anchor(change.anchor)
            if change.axis == "losses":
                continue  # it changes what is subtracted on both sides
            before = lost_by(anchor)
            after = lost_by(reading)
            points = {name: _change(before[name], after[name]) for name in before}
            deviance = _best_deviance(results, reading) - _best_deviance(results, anchor)
            flights = results.flown[study.flights_of(reading)].flights
            golden = [part.golden.counts().rate for part in flights.values()]
            all_effects.append(ChangeEffect(change.anchor, change.axis, change.value, points, golden, deviance))
    return sorted(all_effects, key=lambda effect: -effect.largest)


def _change(before: PointsDifference, after: PointsDifference) -> PointsDifference:
    """Difference of two independent differences, with MOVER's interval."""
    points = after.points - before.points
    below = np.hypot(after.points - after.low, before.high - before.points)
    above = np.hypot(after.high - after.points, before.points - before.low)
    return PointsDifference(points, float(points - below), float(points + above))


def _best_deviance(results: AssumptionResults, reading: PaperReading) -> float:
    """Deviance with the values of `losses` that fit best."""
    flights = results.flown[results.study.flights_of(reading)].flights
    values = results.study.axes["losses"].values
    return min(fit_of(results.study, reading.with_value("losses", name), flights).deviance for name in values)


def axes_table(results: AssumptionResults) -> StoredTable:
    """Single changes of the anchors, the largest effect first."""
    study = results.study
    rows = []
    for effect in effects(results):
        value = study.value(effect.axis, effect.value)
        cells = [_points_text(effect.points[name]) for name in study.environments]
        golden = " / ".join(f"{100 * rate:.0f}" for rate in effect.golden)
        title = study.axes[effect.axis].title
        rows.append((title, value.text, value.source, effect.anchor, golden, *cells, effect.deviance))
    columns = ("axis", "value", "source", "anchor", "golden", *results.study.environments, "deviance")
    return StoredTable("axes", columns, rows)


def _points_text(change: PointsDifference) -> str:
    return f"{change.points:+.1f} [{change.low:+.1f}, {change.high:+.1f}]"


def readings_table(results: AssumptionResults) -> StoredTable:
    """The readings that fit best, and the anchors."""
    study = results.study
    anchors = {study.anchor(name): name for name in study.anchors}
    frozen = [part.fitted for part in results.frozen]
    best = list(results.fitted[:_SHOWN])
    best += [item for item in frozen if item not in best]
    best += [item for item in results.fitted[_SHOWN:] if item.reading in anchors and item not in best]
    rows = []
    for item in best:
        flights = results.flown[item.flown].flights
        cells = [_lost_text(part, study.value("deaths", item.reading["deaths"]).deaths) for part in flights.values()]
        n = sum(len(part.faulty["fi"].success) for part in flights.values())
        interval = ""
        if item in frozen:
            deaths, losses = (study.value(axis, item.reading[axis]) for axis in ("deaths", "losses"))
            low, high = deviance_interval(flights, deaths, losses)
            interval = f" [{low:.1f}, {high:.1f}]"
        deviance = f"{item.fit.deviance:.1f}{interval}"
        names = f" (anchor: {anchors[item.reading]})" if item.reading in anchors else ""
        rows.append((item.reading.text + names, *cells, n, deviance, item.fit.freedom, item.fit.p_value))
    paper_row = [f"{100 * (paper_counts(name, 'golden').rate - paper_counts(name, 'fi').rate):.1f}" for name in flights]
    rows.insert(0, ("the paper", *paper_row, None, "", None, None))
    columns = ("reading", *results.study.environments, "n", "deviance", "freedom", "p")
    return StoredTable("readings", columns, rows)


def _lost_text(part: EnvironmentFlights, deaths: str) -> str:
    lost = part.golden.counts().rate - part.faulty["fi"].counts(deaths).rate
    return f"{100 * lost:.1f}"


# ---- the paper's findings under these readings -----------------------------------------------------------------------
def findings_table(results: AssumptionResults) -> StoredTable:
    """For each finding of the paper that is tested on missions, the readings that confirm or contradict it."""
    # ways of counting share their flights
    combinations = list({_name_of_flights(part): part.detectors.runs for part in combinations_of(results)}.items())
    of_instructions = list(_flown_at(results, INSTRUCTION))
    of_fields = [(name, _by_field(runs)) for name, runs in _flown_at(results, STATE)]
    rows = []
    for claim in CLAIMS.values():
        tested: Sequence[tuple[str, Runs]] = ()
        if claim.campaign in (AS_PUBLISHED, VALUES, INSTRUCTIONS):
            tested = combinations
        if claim.campaign == KERNELS:
            tested = of_instructions
        if claim.name == "collision_seq_robust":
            tested = of_fields
        if not _has_twin(claim):
            rows.append(_finding(claim, tested))
    columns = ("statement", "section", "confirmed", "contradicted", "left")
    return StoredTable("findings", columns, rows)


def _name_of_flights(combination: Combination) -> str:
    """Name of a combination without the way of counting."""
    return f"{combination.frozen.fitted.reading['where']} with {combination.detectors.name}"


def _has_twin(claim: Claim) -> bool:
    """Whether the same statement is tested under another name: that of the campaign `as_published`."""
    base = claim.name.removesuffix("_in_states")
    return claim.campaign in (VALUES, INSTRUCTIONS) and f"{base}_as_published" in CLAIMS


def _flown_at(results: AssumptionResults, level: str) -> Iterator[tuple[str, Runs]]:
    """Readings that were flown with faults of a level, with the runs of all rounds."""
    for reading, part in results.flown.items():
        if results.study.sampling_of(reading).get("level", STATE) == level:
            rounds = [Runs.read(path) for path in part.ledgers]
            frame = pl.concat([runs.frame for runs in rounds])
            yield reading.text, replace(rounds[0], frame=frame)


def _by_field(runs: Runs) -> Runs:
    """Runs whose target is the field that was hit; all faults count, as drawn."""
    return runs.adding(target=pl.col("field"), population=pl.lit(ALL_BITS))


def _finding(claim: Claim, tested: Sequence[tuple[str, Runs]]) -> tuple[object, ...]:
    """Row of a claim: the readings by verdict."""
    statement = claim.statement
    if claim.campaign in (AS_PUBLISHED, VALUES):
        statement = re.sub(r"^Table I, [^:]*:", "Table I:", statement)
    evidence = [claim.test(runs) for _, runs in tested]
    if all(part.p_value is None for part in evidence):
        reach = _OUT_OF_REACH.get(claim.section, "not measured by these flights")
        return statement, claim.section, "—", "—", reach
    adjusted = holm([part.p_value for part in evidence])
    names: dict[str, list[str]] = {CONFIRMED: [], CONTRADICTED: [], UNDECIDED: []}
    for (name, _), part, p in zip(tested, evidence, adjusted, strict=True):
        names[verdict(part, p)].append(name)
    undecided = f"undecided in {len(names[UNDECIDED])} of {len(tested)}"
    return statement, claim.section, _listed(names[CONFIRMED]), _listed(names[CONTRADICTED]), undecided


def _listed(names: Sequence[str]) -> str:
    """Names of readings, of many their number and the first."""
    if len(names) > _LISTED:
        return f"{len(names)} readings, e.g. {names[0]}"
    return "; ".join(names) or "—"


# ---- checks that were not fitted -------------------------------------------------------------------------------------
def worst_times_table(results: AssumptionResults) -> StoredTable:
    """Fig. 6 and Table II: worst flight times and recomputation, beside the paper's."""
    best = best_combination(results)
    rows = []
    for name in results.study.environments:
        for setting, words in {"fi": "one fault", **_SHORT}.items():
            runs = best.detectors.runs.injected.where("judged", environment=name, setting=setting)
            worst = runs.frame["inflation"].max()
            share = None
            papers_share = None
            if setting != "fi":
                share = recomputed_share(runs.recorded(), ())
                papers_share = paper.figure("overhead", environment=name, setting=setting)
            rows.append((name, words, worst, paper.worst_time(name, setting), share, papers_share))
    columns = ("environment", "setting", "worst", "paper_worst", "share", "paper_share")
    return StoredTable("checks", columns, rows)


def ledgers_table(results: AssumptionResults) -> StoredTable:
    """Digests of all ledgers."""
    rows = [(folder, short(digest)) for folder, digest in results.ledgers.items()]
    return StoredTable("ledgers", ("folder", "digest"), rows)
