"""Write docs/results/hardening.md: curves, plan and certificate of the kernels.

    make results NAME=hardening          # = python -m tools.build_hardening, with the options below

Each choice has `--learn` times as many injections as those of `mavfi harden`, which has a minute, and more in functions
with a limit of time of which few are silent.  All steps are timed, and a function is timed for `--seconds`: two steps
may differ by 1 % in time.  Certified are these fractions, and for functions with a limit the largest one within it.
What is measured is kept in out/hardening/hardening.jsonl: the command continues where it was stopped, and can be
repeated with more faults, fractions or flights.
"""

import argparse
import hashlib
import json
import math
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

from mavfi.analysis.statistics import Rate
from mavfi.analysis.table import NUMBER, Column, Table
from mavfi.campaign.fingerprint import processor
from mavfi.errors import BadInputError
from mavfi.extras.hardening.advise import (
    FRACTIONS,
    Advice,
    Curve,
    CurveStep,
    HardeningStudy,
    Ladder,
    advise,
    every_choice,
    plan_of,
    planned_of,
)
from mavfi.extras.hardening.certify import Certification, certify, pairs_of, rate_of, verdict_of
from mavfi.extras.hardening.observed import GoldenCheck, ObservedFunction, check_golden, merged, observe
from mavfi.extras.hardening.plan import ProtectionPlan, load_plan, save_plan
from mavfi.extras.hardening.protected import Protection
from mavfi.extras.hardening.report import advice_table, caveats, certificate_table, headline, verdict_line
from mavfi.extras.hardening.summary import AdviceSummary, growth_of, harm_of, summary
from mavfi.extras.hardening.target import FunctionTarget, Injected, injections_in
from mavfi.flight.compose import resolve
from mavfi.mission import MissionSpec
from tools import results
from tools.markers import ROOT
from tools.stored_certificate import certification_of

PAGE = "hardening"
LEDGER = Path("out/hardening")
PLAN = ROOT / "configs" / "protections" / "ten_percent.yaml"
CERTIFICATE = PLAN.with_suffix(".certificate.json")
ENVIRONMENTS = ("sparse", "dense", "farm", "factory")
TIME_LIMITS = {
    "plan_rrt_connect": 1.2,
    "time_to_collision": 1.2,
    "track": 1.3,
    "apply_updates": 1.3,
    "back_project": 1.5,
    "insert_scan": 1.5,
}
"""Functions of which the largest step within a time ratio is certified as well."""
SILENT_NEEDED = 300
"""Silent corruptions from which a choice for such a function is made: fewer leave open which of its last instructions
matter."""
MAX_LEARNING_FACTOR = 4
"""Times more injections for that, at most."""
FAULT_FACTORS = {"plan_rrt_connect": 24, "time_to_collision": 40, "insert_scan": 16, "track": 4}
"""Times more faults in the largest step within the time, where few faults are silent."""
FINE_FRACTIONS = tuple(step / 40 for step in range(1, 41))
"""Steps of such functions: twice those of others."""
LONG_CALL = 2_000_000
"""Instructions per call above which a quarter of the faults must do."""
INTERVAL = "percent with interval"
Row = dict[str, Any]


class Records:
    """Results by key, one JSON object per line; `times` as many injections are learned from as by `mavfi harden`."""

    def __init__(self, path: Path, times: int) -> None:
        self._path = path
        self._times = times
        self.rows: dict[str, Row] = {}
        if path.exists():
            for line in path.read_text(encoding="utf-8").splitlines():
                row = json.loads(line)
                self.rows[row.pop("key")] = row

    def get(self, key: str) -> Row | None:
        """A result, if it is known."""
        return self.rows.get(key)

    def put(self, key: str, row: Row) -> Row:
        """Store a result."""
        self.rows[key] = row
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"key": key, **row}) + "\n")
        return row

    def learn(self, seen: ObservedFunction) -> list[Injected]:
        """The injections from which the protection of a function is chosen."""
        injections = self._injections(seen, self._times)
        silent = sum(injected.sdc for injected in injections)
        if seen.entry in TIME_LIMITS and 0 < silent < SILENT_NEEDED:
            factor = min(SILENT_NEEDED / silent, MAX_LEARNING_FACTOR)
            injections = self._injections(seen, math.ceil(self._times * factor))
        return injections

    def _injections(self, seen: ObservedFunction, times: int) -> list[Injected]:
        key = f"learned {times} in {len(seen.parts)} missions {seen.variant.ir_sha256}"
        row = self.get(key)
        if row is None:
            row = self.put(key, {"injections": injections_in(seen, times)})
        return [Injected(*fields) for fields in row["injections"]]


def choices(target: FunctionTarget) -> Ladder:
    """All steps of a function: where few faults are silent, a larger one may remove more although none is seen."""
    if target.seen.entry in TIME_LIMITS:
        return every_choice(target, FINE_FRACTIONS)
    return every_choice(target, FRACTIONS)


def code_of(plan: ProtectionPlan) -> str:
    """Digest of what determines the protected code: not of times, which differ from one measurement to the next."""
    return hashlib.sha256(b"".join(Protection(planned).key for planned in plan.functions)).hexdigest()


def certificates(
    study: HardeningStudy, advices: Sequence[Advice], fractions: Sequence[float], faults: int, records: Records
) -> Iterator[tuple[Curve, CurveStep, Row]]:
    """Certify steps of all functions with fresh missions; flights are flown only if something is not known.

    A certificate holds for any prediction of the same code: its verdict is that on the present one.
    """
    for (planner, kernels), advice in zip(study.by_planner().items(), advices, strict=True):
        missions = FreshMissions(study, planner, kernels)
        for curve in advice.curves:
            largest = largest_within_limit(curve)
            for step in curve.steps[1:]:
                planned = planned_of(curve.target, step)
                plan = ProtectionPlan(functions=(planned,))
                key = code_of(plan)
                row = records.get(key)

                # certify what is asked for and not known, or known from fewer faults; what is known is shown anyway
                n = faults_in(curve, faults, is_largest=step.fraction == largest)
                if step.fraction in (*fractions, largest) and (row is None or row["sdc_after"]["n"] < n):
                    pairs = pairs_of(missions.functions, plan)
                    if pairs:
                        print(planned.function, step.fraction, flush=True)
                        row = records.put(key, {**certify(pairs[0], n, key).to_json()})
                    else:  # the fresh missions do not call the function
                        row = None
                if row is not None:
                    row["verdict"] = verdict_of(Rate(**row["coverage"]), rate_of(planned.predicted))
                    yield curve, step, row


class FreshMissions:
    """Missions of a planner that no choice has seen; they are flown when their functions are first asked for."""

    def __init__(self, study: HardeningStudy, planner: str, kernels: Sequence[str]) -> None:
        self._study = study
        self._planner = planner
        self._kernels = kernels

    @cached_property
    def functions(self) -> list[ObservedFunction]:
        """The functions of all missions, with their recorded calls."""
        functions = []
        for scenario in self._study.fresh(self._planner):
            for observed in observe(scenario, self._kernels).values():
                functions += observed
        return merged(functions)


def largest_within_limit(curve: Curve) -> float:
    """Fraction of the largest step of a function within its limit of time; 0 without a limit."""
    limit = TIME_LIMITS.get(curve.target.seen.entry, 0.0)
    return max((step.fraction for step in curve.steps if step.time <= limit), default=0.0)


def faults_in(curve: Curve, faults: int, *, is_largest: bool) -> int:
    """Number of faults for a step: fewer in long calls, more in the largest step within a limit of time."""
    seen = curve.target.seen
    if seen.instructions >= LONG_CALL * seen.total:
        faults //= 4
    if is_largest:
        faults *= FAULT_FACTORS.get(seen.entry, 1)
    return faults


def golden(study: HardeningStudy, plan: ProtectionPlan, flights: int, records: Records) -> GoldenCheck:
    """Fly golden missions plain and protected, in four environments; sum over these and earlier plans.

    Each planner of the study is flown in all of them.
    """
    for index, (planner, kernels) in enumerate(study.by_planner().items()):
        suffix = ""
        if index > 0:  # keys of the first planner are as old as the ledger, which had one
            suffix = f" {planner}"
        for environment, seed in product(ENVIRONMENTS, range(200, 200 + flights)):
            key = f"golden {code_of(plan)} {environment} {seed}{suffix}"
            if records.get(key) is None:
                spec = MissionSpec(environment=environment, seed=seed, planner=planner)
                records.put(key, check_golden(resolve(spec), plan, kernels)._asdict())
    total = GoldenCheck()
    for key, row in records.rows.items():
        if key.startswith("golden "):
            total = total.plus(GoldenCheck(**row))
    return total


# ---- tables ---------------------------------------------------------------------------------------------------------
def curve_table(curves: Sequence[Curve], certified: Mapping[tuple[str, str, float], Row]) -> Table:
    """A row for each step of each function; of the fine ones, only for those that are certified.

    Args:
        curves: Curves of all functions.
        certified: Certificates by function, signature and fraction.
    """
    columns = (
        Column("function", "function"),
        Column("kernel", "kernel"),
        Column("step", "step", "number g"),
        Column("instructions", "instr. ×", "number .2f"),
        Column("time", "time ×", "number .2f"),
        Column("predicted", "SDCs removed, predicted", INTERVAL),
        Column("n", "n", NUMBER),
        Column("before", "SDC before", INTERVAL),
        Column("after", "SDC after", INTERVAL),
        Column("removed", "SDCs removed", INTERVAL),
        Column("verdict", "prediction"),
    )

    # what was predicted for each step, then what was measured if it is certified
    rows: list[tuple[Any, ...]] = []
    for curve in curves:
        for step in curve.steps[1:]:
            row = certified.get((*curve.target.key, step.fraction))
            if row is None and step.fraction not in FRACTIONS:
                continue
            measured: tuple[Any, ...] = (None,) * 5
            if row is not None:
                rates = (Rate(**row[key]) for key in ("sdc_before", "sdc_after", "coverage"))
                measured = (row["sdc_after"]["n"], *rates, row["verdict"])
            name = (curve.target.seen.entry, ", ".join(curve.target.kernels), step.fraction)
            rows.append((*name, growth_of(curve, step), step.time, step.coverage, *measured))
    return Table("curves", "Curves and certificates of all functions", columns, rows, keys=3)


# ---- the page -------------------------------------------------------------------------------------------------------
def certificate(path: Path = CERTIFICATE) -> Certification:
    """The shipped certificate.

    Raises:
        BadInputError: It is of another plan.
    """
    certification = certification_of(json.loads(path.read_text(encoding="utf-8")))
    plan = load_plan(PLAN)
    if certification.plan != plan.digest:
        raise BadInputError(f"{path.name}: of plan {certification.plan[:12]}, this is {plan.digest[:12]}; certify it")
    return certification


def certificate_sentence(certification: Certification, page: str) -> str:
    """What the certificate says, and on which processor its times were measured if not on that of the page."""
    cpu = load_plan(PLAN).cpu
    remark = ""
    if cpu not in page:
        remark = f" Chosen with times on {cpu}; the study was timed on another processor."
    return f"The shipped plan{verdict_line(certification).removeprefix('The plan')}{remark}"


def write_page(study: HardeningStudy, advice: AdviceSummary, curves: Table, check: GoldenCheck) -> Path:
    """Write the page."""
    campaign = study.campaign
    shipped = certificate()
    about = [
        f"campaign `{campaign.name}` ({', '.join(campaign.environments)}, {campaign.missions} missions from seed "
        f"{campaign.first_seed}, {campaign.faults} faults per kernel); {processor()}; method: "
        "[hardening](../how-to/hardening.md)",
        f"golden digests of protected flights: {check.same} of {check.flights} equal; {check.alarms} false alarms in "
        f"{check.calls:,} calls (without charged time: with it the longer latency changes the flight)",
    ]
    verdict = certificate_sentence(shipped, processor())
    text = f"{headline(advice)} {' '.join(caveats(advice))} {verdict}"
    tables = {"plan": advice_table(advice), "certificate": certificate_table(shipped), "curves": curves}
    return results.write(PAGE, "Hardening of the kernels", text, tables, [results.Excerpt("plan")], about)


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--learn", type=int, default=3, help="times as many injections per choice as `mavfi harden`")
    parser.add_argument("--faults", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=20.0, help="for how long a function is timed")
    parser.add_argument("--fractions", default="0.5,0.75,1")
    parser.add_argument("--flights", type=int, default=10, help="golden missions per environment")
    parser.add_argument("--budget", type=float, default=0.10)
    options = parser.parse_args()

    # fly the campaign, and choose what to protect
    mavfi = [sys.executable, "-m", "mavfi"]
    subprocess.run([*mavfi, "campaign", "run", "hardening", "--out", str(LEDGER)], cwd=ROOT, check=True)
    study = HardeningStudy.open(LEDGER)
    records = Records(LEDGER / "hardening.jsonl", options.learn)
    advices = advise(
        study,
        options.budget,
        lambda text: print(text, flush=True),
        inject=records.learn,
        workers=os.cpu_count() or 1,
        seconds=options.seconds,
        choices=choices,
    )
    advice = summary(study, advices, harm_of(study.runs))
    plan = plan_of(study, advices)
    save_plan(plan, PLAN)

    # check golden flights under the plan, and certify steps of the curves
    curves = [curve for advice_of_planner in advices for curve in advice_of_planner.curves if len(curve.steps) > 1]
    check = golden(study, plan, options.flights, records)
    fractions = [float(text) for text in options.fractions.split(",") if text]
    certified = {
        (*curve.target.key, step.fraction): row
        for curve, step, row in certificates(study, advices, fractions, options.faults, records)
    }

    # certify the plan itself; the exit code is 3 if a prediction is refuted, which the page says
    certifying = [*mavfi, "harden", str(LEDGER), "--plan", str(PLAN), "--certify", "--faults", "1000"]
    code = subprocess.run(certifying, cwd=ROOT, check=False).returncode
    if code not in (0, 3):
        sys.exit(code)
    page = write_page(study, advice, curve_table(curves, certified), check)
    print(f"wrote {page.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
