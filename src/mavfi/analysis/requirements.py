"""Judges requirements on a campaign by the bounds of its rates, and writes the verdicts as JUnit XML."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import polars as pl

from mavfi.analysis import measures as m
from mavfi.analysis.comparison import ComparedRuns, difference, shared_samples
from mavfi.analysis.effects import ALARMED, effect_rate, has_verdicts, judged_faults
from mavfi.analysis.rows import KERNEL_DUE
from mavfi.analysis.runs import Runs
from mavfi.analysis.statistics import Rate, wilson
from mavfi.campaign.plan import FI
from mavfi.campaign.requirement import CAMPAIGNS, MISSION, Requirement
from mavfi.errors import BadInputError, writing


class Holds(Enum):
    """Whether a requirement holds; the value is the word for people."""

    YES = "holds"
    NO = "violated"
    NOT_SHOWN = "not shown"


@dataclass(frozen=True, slots=True)
class RequirementVerdict:
    """A judged requirement."""

    requirement: Requirement
    rate: Rate
    golden: Rate | None = None
    """The same share of the runs without a fault; None = there is none, or it is a difference."""

    @property
    def holds(self) -> Holds:
        """By the bound of the interval that is farther from meeting the requirement."""
        rate = self.rate
        if rate.low is None or rate.high is None:
            return Holds.NOT_SHOWN
        limit = self.requirement.limit
        meets: Mapping[str, Callable[[float], bool]] = {
            "<": lambda bound: bound < limit,
            "<=": lambda bound: bound <= limit,
            ">": lambda bound: bound > limit,
            ">=": lambda bound: bound >= limit,
        }
        bounds = (rate.low, rate.high)
        met = [meets[self.requirement.comparison](bound) for bound in bounds]
        if all(met):
            return Holds.YES
        if not any(met):
            return Holds.NO
        return Holds.NOT_SHOWN

    @property
    def line(self) -> str:
        """Verdict, requirement, rate with its interval, and n, in one line."""
        rate = self.rate
        text = f"{self.holds.value:9}  {self.requirement.text}"
        if not rate.percent:
            return f"{text}: n = {rate.n}, no rate"
        text = f"{text}: {rate.percent}, n = {rate.n}"
        if self.golden is not None and self.golden.percent:
            text = f"{text}; without a fault {self.golden.percent}, n = {self.golden.n}"
        if self.holds is Holds.NOT_SHOWN:
            return f"{text}: n too small"
        return text

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        rate = self.rate
        return {
            "requirement": self.requirement.text,
            "verdict": self.holds.value,
            "n": rate.n,
            "rate": rate.rate,
            "low": rate.low,
            "high": rate.high,
        }


def judge(runs: Runs, requirements: Sequence[Requirement]) -> list[RequirementVerdict]:
    """Judge requirements, whose arms are known, by the runs of a campaign."""
    verdicts = []
    for requirement in requirements:
        if requirement.minus:
            verdicts.append(RequirementVerdict(requirement, _difference_of_settings(runs, requirement)))
        else:
            golden = _golden_rate(runs, requirement)
            verdicts.append(RequirementVerdict(requirement, _rate(runs, requirement), golden))
    return verdicts


def judge_campaigns(runs_a: Runs, runs_b: Runs, requirements: Sequence[Requirement]) -> list[RequirementVerdict]:
    """Judge requirements on the difference of two campaigns, in fi or in the arm that a requirement names.

    Raises:
        BadInputError: The campaigns do not share such a setting.
    """
    samples, _ = shared_samples(runs_a, runs_b)
    verdicts = []
    for requirement in requirements:
        setting = FI
        if requirement.arm:
            setting = f"dr_{requirement.arm}"
        shared = [sample for (_, name), sample in samples if name == setting]
        if not shared:
            names = ", ".join(sorted({name for (_, name), sample in samples}))
            raise BadInputError(f"{requirement.text!r}: {setting} is not compared; compared: {names}")
        rate = difference(ComparedRuns.joined(shared), _test(requirement.measure))
        if requirement.minus != CAMPAIGNS:
            rate = rate.negative
        verdicts.append(RequirementVerdict(requirement, rate))
    return verdicts


def _difference_of_settings(runs: Runs, requirement: Requirement) -> Rate:
    """The difference of two settings, in pairs of the same faults."""
    faults = judged_faults(runs)
    by_setting = []
    for name in requirement.minus:
        if name == FI:
            by_setting.append(faults.where(setting=FI))
        else:
            by_setting.append(faults.where(arm=name))
    first, second = by_setting
    if not has_verdicts(runs) and requirement.measure in MISSION:
        return wilson(0, 0)
    return difference(ComparedRuns.of(first, second, _SAME_DRAW), _test(requirement.measure))


_SAME_DRAW = ("environment", "seed", "target", "index")
"""Columns that identify a fault in all settings of a campaign."""


def _golden_rate(runs: Runs, requirement: Requirement) -> Rate | None:
    """Missions without a fault in the requirement's arm, if the requirement is about missions."""
    if requirement.measure not in MISSION or not has_verdicts(runs):
        return None
    return m.rate_of(runs.golden.where("judged", arm=requirement.arm), _test(requirement.measure))


def _test(measure: str) -> pl.Expr:
    """Whether a run counts in a measure of faults."""
    if measure == "success":
        return pl.col("success")
    if measure == "mission lost":
        return ~pl.col("success")
    if measure == "due":
        return pl.col("effect").is_in(KERNEL_DUE)
    return pl.col("effect") == measure


def _rate(runs: Runs, requirement: Requirement) -> Rate:
    """The rate that a requirement bounds."""
    measure = requirement.measure
    if measure == "false alarms":
        watched = runs.golden.where("judged", arm=requirement.arm)
        return m.rate_of(watched, pl.col("alarms_total") > 0)
    if measure == "recovered":
        return _recovered(runs, requirement.arm)

    # Shares of the faults in the arm, over whole words if their bits were drawn by strata.
    faults = judged_faults(runs).where(arm=requirement.arm)
    if not requirement.arm:
        faults = faults.where(setting=FI)
    if measure == "detected":
        return effect_rate(faults, ALARMED)
    if measure in MISSION and not has_verdicts(runs):
        return wilson(0, 0)
    return effect_rate(faults, _test(measure))


def _recovered(runs: Runs, arm: str) -> Rate:
    """Recovery rate of an arm, of the missions that its faults lose without a detector."""
    leading = m.leading_faults(runs).values("population")
    pairs = m.against_fi(runs).where(pl.col("population").is_in(leading), arm=arm)
    recovery = m.recovery_of(pairs)
    if recovery is None:
        return wilson(0, 0)
    return recovery.rate


# ---- for programs that read test results -----------------------------------------------------------------------------
def write_junit(path: Path, name: str, verdicts: Sequence[RequirementVerdict]) -> None:
    """Write verdicts as JUnit XML, one test case per requirement.

    Args:
        path: The file.
        name: Name of the campaign.
        verdicts: Its judged requirements.

    Raises:
        BadInputError: The file cannot be written.
    """
    failed = [verdict for verdict in verdicts if verdict.holds is not Holds.YES]
    counts = {"tests": str(len(verdicts)), "failures": str(len(failed)), "errors": "0", "skipped": "0"}
    suite = ElementTree.Element("testsuite", {"name": f"mavfi {name}", **counts})
    for verdict in verdicts:
        case = ElementTree.SubElement(
            suite, "testcase", {"classname": f"mavfi.{name}", "name": verdict.requirement.text, "time": "0"}
        )
        if verdict.holds is not Holds.YES:
            ElementTree.SubElement(case, "failure", {"message": verdict.line, "type": verdict.holds.value})
        else:
            ElementTree.SubElement(case, "system-out").text = verdict.line
    suites = ElementTree.Element("testsuites", counts)
    suites.append(suite)
    ElementTree.indent(suites)
    with writing(path):
        ElementTree.ElementTree(suites).write(path, encoding="utf-8", xml_declaration=True)
