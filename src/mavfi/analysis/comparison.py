"""Two campaigns compared: how often missions fail, how long they fly, and what energy they need.

Runs are pairs if they have the same environment, seed and setting and, with a fault, the same one.  Groups of which at
least the share `_SHARED` has a partner are compared in pairs, whose differences are more precise; others as independent
samples.  All runs of a mission, also those with different faults, are one cluster.
"""

import html
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import polars as pl

from mavfi.analysis.effects import has_verdicts
from mavfi.analysis.measures import rate_of, word_weights
from mavfi.analysis.rows import GOLDEN, NULL
from mavfi.analysis.runs import ALL, Runs
from mavfi.analysis.statistics import Rate, paired_difference, relative_difference, unpaired_difference, wilson
from mavfi.analysis.table import DIFFERENCE, NUMBER, PERCENT, TEXT, Column, Table
from mavfi.campaign.plan import FI
from mavfi.errors import BadInputError
from mavfi.record import plain

_SHARED = 0.5
_MISSION = ("environment", "seed", "setting")
_FAULT = ("target", "index", "level", "site", "bit", "stratum")
"""Columns that identify a run of a campaign, and the fault in it.

Its instant is none of them: the same draw may hit another instant of another flight.
"""
_DEFAULT = "default"
"""Value of a key that a campaign does not set."""


@dataclass(frozen=True, slots=True)
class ComparedGroup:
    """The runs that two campaigns A and B have in one environment and setting.

    Differences are B - A, with 95 % intervals; their bounds are None with fewer than two missions.

    Attributes:
        environment: Name, or `ALL`.
        setting: Setting, e.g. fi.
        has_fault: Whether its runs have a fault.
        paired: Whether runs are compared in pairs.
        n_a: Compared runs of A; of both if in pairs.
        n_b: Compared runs of B.
        missions: Number of missions that these runs fly, each a cluster.
        same: Pairs whose flights are equal bit for bit; None without pairs.
        failed_a: Share of the runs of A whose mission fails.
        failed_b: That of B.
        failures: Difference of the shares.
        flight_time: Relative difference of the mean flight time, of pairs that both succeed or of all that succeed.
        energy: That of the energy.
    """

    environment: str
    setting: str
    has_fault: bool
    paired: bool
    n_a: int
    n_b: int
    missions: int
    same: int | None
    failed_a: Rate
    failed_b: Rate
    failures: Rate
    flight_time: Rate
    energy: Rate


@dataclass(frozen=True, slots=True, repr=False)
class CampaignComparison:
    """Two campaigns, A and B.

    Attributes:
        answer: The headline: one setting over all environments; fi, else the first with a fault, else the first.
        groups: By setting: over all environments if there are several, then each.
        differing: What distinguishes the campaigns, by key: the values of A and B.
        notes: What is not compared, and why.
    """

    answer: ComparedGroup
    groups: tuple[ComparedGroup, ...]
    differing: Mapping[str, tuple[Any, Any]]
    notes: tuple[str, ...]

    @property
    def are_same(self) -> bool:
        """Whether all compared flights are pairs that are equal bit for bit."""
        return all(group.same == group.n_a for group in self.groups)

    @property
    def sentences(self) -> list[str]:
        """The answer: failures, then what flight time and energy differ by."""
        if self.are_same:
            shared = sum(group.n_a for group in self.groups if group.environment != ALL)  # without totals
            same = f"B flies as A: all {shared} shared runs are equal bit for bit."
            if not self.answer.has_fault:
                same = f"Without a fault, {same}"
            return [same]
        failures = _failures_sentence(self.answer)
        golden = self._golden_of_answer
        if self.answer.has_fault and golden is not None:
            failures = (
                f"{failures[:-1]}; without a fault A fails {golden.failed_a.percent}, B {golden.failed_b.percent}."
            )
        return [failures, _cost_sentence(self.answer)]

    @property
    def _golden_of_answer(self) -> ComparedGroup | None:
        """The runs of the answer's arm without a fault, if they are compared."""
        arm = self.answer.setting.removeprefix("dr_")
        settings = (f"{GOLDEN}_{arm}", GOLDEN)
        golden = [group for group in self.groups if group.setting in settings]
        golden = [group for group in golden if group.environment == self.answer.environment]
        golden.sort(key=lambda group: settings.index(group.setting))
        return next(iter(golden), None)

    def __repr__(self) -> str:
        return "\n".join(self.sentences)

    def _repr_html_(self) -> str:
        """The answer and the table in a notebook."""
        return "".join(f"<p>{html.escape(sentence)}</p>" for sentence in self.sentences) + self.table._repr_html_()

    @property
    def table(self) -> Table:
        """One row per group; shares, and whether runs are pairs, are hidden columns."""
        columns = (
            Column("row", "setting"),
            Column("runs", "runs", NUMBER),
            Column("failures", "failures, points", DIFFERENCE),
            Column("flight_time", "flight time, %", DIFFERENCE),
            Column("energy", "energy, %", DIFFERENCE),
            Column("setting", "setting", TEXT, hidden=True),
            Column("environment", "environment", TEXT, hidden=True),
            Column("failed_a", "A fails", PERCENT, hidden=True),
            Column("failed_b", "B fails", PERCENT, hidden=True),
            Column("missions", "missions", NUMBER, hidden=True),
            Column("paired", "paired", TEXT, hidden=True),
        )
        rows = []
        setting = ""
        for group in self.groups:
            cells: dict[str, Any] = {key: getattr(group, key) for key in ComparedGroup.__slots__}
            # Environments stand below the row of their setting.
            cells["row"] = group.setting
            if group.setting == setting:
                cells["row"] = f"· {group.environment}"
            setting = group.setting
            if group.same == group.n_a:
                cells |= dict.fromkeys(("failures", "flight_time", "energy"), "all equal")
            cells["runs"] = str(group.n_a)
            if not group.paired:
                cells["runs"] = f"{group.n_a}/{group.n_b}"
            rows.append(tuple(cells[column.key] for column in columns))
        return Table(
            "compare", "B - A, with 95 % intervals; not shown: they contain 0", columns, rows, notes=self.notes
        )

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        data: dict[str, Any] = plain(
            {
                "sentences": self.sentences,
                "answer": asdict(self.answer),
                "groups": [asdict(group) for group in self.groups],
                "differing": {key: list(values) for key, values in self.differing.items()},
                "notes": self.notes,
            }
        )
        return data


def compare(runs_a: Runs, runs_b: Runs) -> CampaignComparison:
    """Compare the runs of two ledgers.

    Raises:
        BadInputError: They have no environment and setting in common, or their runs are no missions.
    """
    for name, runs in (("A", runs_a), ("B", runs_b)):
        if not runs.has_missions and not has_verdicts(runs):
            raise BadInputError(f"{name}: its runs are no missions, which succeed or fail; allowed: campaigns that fly")
    samples, notes = shared_samples(runs_a, runs_b)
    groups = _groups(samples)
    return CampaignComparison(_answer(groups), groups, _differing(runs_a, runs_b), tuple(notes))


SettingSamples = Sequence[tuple[tuple[Any, ...], "ComparedRuns"]]
"""Compared runs by (environment, setting)."""


def shared_samples(runs_a: Runs, runs_b: Runs) -> tuple[SettingSamples, Sequence[str]]:
    """What two campaigns have in common, and notes on what is not compared.

    Raises:
        BadInputError: They have no setting in common.
    """
    notes = [*_progress_notes("A", runs_a), *_progress_notes("B", runs_b)]
    judged_a = runs_a.where("judged", pl.col("kind") != NULL)
    judged_b = runs_b.where("judged", pl.col("kind") != NULL)

    # Faults of other kinds are other questions.
    reason = _incomparable_faults(runs_a, runs_b)
    if reason:
        notes.append(f"runs with a fault are not compared: {reason}")
        judged_a = judged_a.golden
        judged_b = judged_b.golden
    if runs_a.campaign.get("host") != runs_b.campaign.get("host"):
        hosts = f"{runs_a.campaign.get('host')} in A, {runs_b.campaign.get('host')} in B"
        notes.append(f"other hosts ({hosts}): a difference may be that of the hosts")
    # Faults of one distribution can be compared even if they are different faults.
    same_draws = runs_a.campaign.get("sampling") == runs_b.campaign.get("sampling")
    if not reason and not same_draws:
        notes.append("faults are drawn in other ways (sampling): only runs with the same fault are compared")

    # Pairs, and what has no counterpart.
    groups_a = judged_a.groups("environment", "setting")
    groups_b = judged_b.groups("environment", "setting")
    common = [key for key in groups_a if key in groups_b]
    notes += _only_in("A", groups_a, groups_b)
    notes += _only_in("B", groups_b, groups_a)
    samples = []
    for key in common:
        sample = ComparedRuns.of(groups_a[key], groups_b[key])
        if not sample.paired and not same_draws and groups_a[key].first("kind") != GOLDEN:
            notes.append(f"{' '.join(key)}: no shared faults, not compared")
            continue
        samples.append((key, sample))
    if not samples:
        raise BadInputError(f"A and B have nothing to compare: {'; '.join(notes)}")
    if judged_a.injected.frame["stratum"].n_unique() > 1:
        notes.append("shares are those of the faults as drawn: strata are not weighted")
    left_out = sum(sample.left_out for _, sample in samples)
    if left_out:
        notes.append(f"{left_out} runs have no partner (another seed, or the draw hit another bit), and are left out")
    return samples, notes


# ---- what can be compared --------------------------------------------------------------------------------------------


def _progress_notes(name: str, runs: Runs) -> list[str]:
    """Notes on missing runs, and on those that could not be judged."""
    notes = []
    done = runs.campaign.get("done")
    total = runs.campaign.get("total")
    if done != total:
        notes.append(f"{name} is not complete: {done} of {total} runs")
    unknown = len(runs.where(judged=False))
    if unknown:
        notes.append(f"{name}: {unknown} runs have status unknown, and are left out")
    return notes


def _incomparable_faults(runs_a: Runs, runs_b: Runs) -> str:
    """Why faults of two campaigns are no faults of the same kind; "" = they are."""
    levels_a = runs_a.injected.values("level")
    levels_b = runs_b.injected.values("level")
    if levels_a and levels_b and set(levels_a) != set(levels_b):
        return f"they are of level {', '.join(levels_a)} in A, {', '.join(levels_b)} in B"
    for name in ("fault space", "python"):
        version_a = runs_a.campaign.get("versions", {}).get(name)
        version_b = runs_b.campaign.get("versions", {}).get(name)
        if None not in (version_a, version_b) and version_a != version_b:
            return f"their {name} has version {version_a} in A, {version_b} in B"
    return ""


def _only_in(name: str, groups: Collection[tuple[Any, ...]], others: Collection[tuple[Any, ...]]) -> list[str]:
    """A note on the environments and settings that only one campaign has."""
    alone = [key for key in groups if key not in others]
    if not alone:
        return []
    environments = {environment for environment, _ in others}
    settings = {setting for _, setting in others}
    labels = []
    for environment, setting in alone:
        label = f"{environment} {setting}"
        if setting not in settings:
            label = setting
        elif environment not in environments:
            label = environment
        labels.append(label)
    return [f"only in {name}: {', '.join(dict.fromkeys(labels))}"]


def _differing(runs_a: Runs, runs_b: Runs) -> dict[str, tuple[Any, Any]]:
    """Keys of the campaigns whose values differ, except how much they fly."""
    flat_a = _flat(runs_a.campaign, runs_b.campaign)
    flat_b = _flat(runs_b.campaign, runs_a.campaign)
    differing = {}
    for key in sorted({*flat_a, *flat_b}):
        value_a = flat_a.get(key, _DEFAULT)
        value_b = flat_b.get(key, _DEFAULT)
        if value_a != value_b:
            differing[key] = (value_a, value_b)
    return differing


def _flat(campaign: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Any]:
    """The keys of a campaign that describe what flies, e.g. `mission.v_max`; of arms and models, those of both."""
    arms = campaign.get("arms", {})
    flat: dict[str, Any] = {"host": campaign.get("host"), "arms": ", ".join(arms) or "none"}
    for part in ("mission", "sampling", "versions"):
        flat |= {f"{part}.{key}": value for key, value in campaign.get(part, {}).items()}
    for part in ("arms", "models"):
        for name in campaign.get(part, {}).keys() & other.get(part, {}).keys():
            flat[f"{part}.{name}"] = campaign[part][name]
    return flat


# ---- pairs and samples -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ComparedRuns:
    """Compared runs: with pairs, both have as many, in the same order; `left_out`: runs without a partner."""

    a: Runs
    b: Runs
    paired: bool
    left_out: int = 0

    @staticmethod
    def of(runs_a: Runs, runs_b: Runs, key: Sequence[str] = (*_MISSION, *_FAULT)) -> "ComparedRuns":
        """Pair the runs of a group that have equal columns `key`, if enough of them have a partner."""
        columns_a = runs_a.frame.select(*key, row_a=pl.int_range(pl.len()))
        columns_b = runs_b.frame.select(*key, row_b=pl.int_range(pl.len()))
        pairs = columns_a.join(columns_b, on=key, nulls_equal=True, maintain_order="left")
        if pairs.height < _SHARED * min(len(runs_a), len(runs_b)):
            return ComparedRuns(runs_a, runs_b, paired=False)
        return ComparedRuns(
            replace(runs_a, frame=runs_a.frame[pairs["row_a"]]),
            replace(runs_b, frame=runs_b.frame[pairs["row_b"]]),
            paired=True,
            left_out=len(runs_a) + len(runs_b) - 2 * pairs.height,
        )

    @staticmethod
    def joined(samples: Sequence["ComparedRuns"]) -> "ComparedRuns":
        """The runs of several groups; pairs only if all are."""
        first = samples[0]
        return ComparedRuns(
            replace(first.a, frame=pl.concat([sample.a.frame for sample in samples])),
            replace(first.b, frame=pl.concat([sample.b.frame for sample in samples])),
            paired=all(sample.paired for sample in samples),
        )


def difference(sample: ComparedRuns, test: pl.Expr) -> Rate:
    """Difference of the shares of runs that pass a test, A - B; over whole words if strata of bits partition them."""
    a = sample.a
    b = sample.b
    passed_a = a.frame.select(test.alias("passed"))["passed"].to_list()
    passed_b = b.frame.select(test.alias("passed"))["passed"].to_list()
    if not len(a) or not len(b):
        return wilson(0, 0)
    if sample.paired:
        estimate = paired_difference(passed_a, passed_b, a["world"], word_weights(a))
    else:
        estimate = unpaired_difference(passed_a, a["world"], passed_b, b["world"])
    return Rate(len(a), estimate.value, estimate.low, estimate.high)


def _answer(groups: Sequence[ComparedGroup]) -> ComparedGroup:
    """One setting over all environments, which come first: fi, else the first with a fault, else the first."""
    without_detector = [group for group in groups if group.setting == FI]
    with_fault = [group for group in groups if group.has_fault]
    return [*without_detector, *with_fault, *groups][0]


def _groups(samples: Sequence[tuple[tuple[Any, ...], ComparedRuns]]) -> tuple[ComparedGroup, ...]:
    """By setting: over all environments if there are several, then each."""
    by_setting: dict[str, dict[str, ComparedRuns]] = {}
    for (environment, setting), sample in samples:
        by_setting.setdefault(setting, {})[environment] = sample
    groups = []
    for setting, by_environment in by_setting.items():
        if len(by_environment) > 1:
            groups.append(_compared(ALL, setting, ComparedRuns.joined(list(by_environment.values()))))
        groups += [_compared(environment, setting, sample) for environment, sample in by_environment.items()]
    return tuple(groups)


def _compared(environment: str, setting: str, sample: ComparedRuns) -> ComparedGroup:
    """The differences of a sample."""
    a = sample.a
    b = sample.b
    failed_a = rate_of(a, ~pl.col("success"))
    failed_b = rate_of(b, ~pl.col("success"))
    succeeded_a = a
    succeeded_b = b
    same = None
    if sample.paired:
        difference = paired_difference(a["success"], b["success"], a["world"])
        both = a.frame["success"] & b.frame["success"]
        succeeded_a = replace(a, frame=a.frame.filter(both))
        succeeded_b = replace(b, frame=b.frame.filter(both))
        flights = zip(a["digest"], b["digest"], strict=True)
        same = sum(digest_a == digest_b and bool(digest_a) for digest_a, digest_b in flights)
    else:
        difference = unpaired_difference(a["success"], a["world"], b["success"], b["world"])
        succeeded_a = a.where("success")
        succeeded_b = b.where("success")
    return ComparedGroup(
        environment,
        setting,
        a.first("kind") != GOLDEN,
        sample.paired,
        len(a),
        len(b),
        len({*a["world"], *b["world"]}),
        same,
        failed_a,
        failed_b,
        Rate(len(a), difference.value, difference.low, difference.high),
        _cost(succeeded_a, succeeded_b, "flight_time_s"),
        _cost(succeeded_a, succeeded_b, "energy_j"),
    )


def _cost(a: Runs, b: Runs, column: str) -> Rate:
    """Relative difference of the means of a column."""
    measured_a = a.where(pl.col(column) > 0)
    measured_b = b.where(pl.col(column) > 0)
    return relative_difference(measured_b[column], measured_b["world"], measured_a[column], measured_a["world"])


# ---- in words --------------------------------------------------------------------------------------------------------


def _failures_sentence(group: ComparedGroup) -> str:
    """How much less, or more, often B fails than A."""
    kind = "runs without a fault"
    if group.has_fault:
        kind = "runs with a fault"
    where = group.setting
    if group.environment != ALL:
        where = f"{group.environment}, {where}"
    on = f"{group.n_a} {kind} of A and {group.n_b} of B, none of them shared"
    if group.paired:
        on = f"{group.n_a} shared {kind} in {group.missions} missions"
    shares = f"A fails {group.failed_a.percent}, B {group.failed_b.percent}"
    if group.same:
        shares += f"; {group.same} runs are equal bit for bit"
    difference = group.failures
    if difference.low is None or difference.high is None or difference.low <= 0 <= difference.high:
        points = f"{100 * (difference.rate or 0.0):+.1f} points {difference.interval or '[?]'}"
        return f"{where}: no difference in failures is shown: {points}, on {on}: {shares}."
    change = f"{difference.percent} more"
    if difference.high < 0:
        change = f"{difference.negative.percent} fewer"
    return f"{where}: B fails {change} missions than A, on {on}: {shares}."


def _cost_sentence(group: ComparedGroup) -> str:
    """What flight time and energy differ by, of missions that succeed."""
    subject = f"Where missions succeed ({group.flight_time.n} or more of each)"
    if group.paired:
        subject = f"Where both succeed (n = {group.flight_time.n})"
    time = _relative(group.flight_time, "longer", "shorter")
    energy = _relative(group.energy, "more", "less")
    return f"{subject}, the flight time of B is {time}, its energy {energy}."


def _relative(change: Rate, more: str, less: str) -> str:
    """A relative change in words."""
    if change.rate is None:
        return "not measured"
    if change.low is None or change.high is None:
        return f"not shown to differ, {100 * change.rate:+z.1f} % [?]"
    if change.low <= 0.0 <= change.high:
        return f"not shown to differ, {change.interval} %"
    if change.rate < 0:
        return f"{change.negative.percent} {less}"
    return f"{change.percent} {more}"
