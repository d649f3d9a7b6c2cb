"""Write docs/generated/hardening.md: curves, plans and certificates of the kernels, and the required values.

python -m tools.build_hardening out/hardening [--learn 3] [--faults 200] [--seconds 20]
    [--fractions 0.5,0.75,1] [--flights 10]

Each choice has `--learn` times as many injections as those of `mavfi harden`, which has a minute, and more in functions
with a bar of which few are silent.  All steps are timed, and a function is timed for `--seconds`: two steps may differ
by 1 % in time.  Certified are these fractions, and for functions with a bar the largest one within its time.  What is
measured is kept in DIR/hardening.jsonl: the command continues where it was stopped, and can be repeated with more
faults, fractions or flights.
"""

import argparse
import hashlib
import json
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import astuple
from datetime import date
from itertools import product
from pathlib import Path
from typing import Any

from mavfi.campaign.analysis.statistics import Rate
from mavfi.campaign.fingerprint import code
from mavfi.campaign.hardening.advise import FRACTIONS, Advice, Curve, Ladder, Step, every_choice
from mavfi.campaign.hardening.certification import merged
from mavfi.campaign.hardening.certify import certify, pairs_of, rate_of, verdict_of
from mavfi.campaign.hardening.golden import GoldenCheck, check_golden
from mavfi.campaign.hardening.learned import Injected, injections_in
from mavfi.campaign.hardening.ledger import harm_of
from mavfi.campaign.hardening.observed import Seen, observe
from mavfi.campaign.hardening.study import Study, advise, plan_of, planned_of
from mavfi.campaign.hardening.summary import AdviceSummary, growth_of, summary
from mavfi.campaign.hardening.target import Target
from mavfi.campaign.overheads import processor
from mavfi.hardening.plan import Plan, save_plan
from mavfi.hardening.protection import Protection
from mavfi.hosts.loop.compose import resolve
from mavfi.mission import MissionSpec
from mavfi.reports.hardening.plain import advice_table, caveats, headline, interval
from mavfi.reports.text import markdown_grid, percent, shown
from tools.hardening_measured import measure, rows
from tools.hardening_requirements import HEADINGS, REQUIRED, all_but_map, of_functions, requirements
from tools.markers import GENERATED, ROOT, banner, fill
from tools.processors import with_others

PAGE = GENERATED / "hardening.md"
PLAN = ROOT / "configs" / "protections" / "ten_percent.yaml"
ENVIRONMENTS = ("sparse", "dense", "farm", "factory")
ENOUGH = 300
"""Silent corruptions from which a choice for a function with a bar is made: fewer leave open which of its last
instructions matter."""
LEARNED = 4
"""Times more injections for that, at most."""
MORE = {"plan_rrt_connect": 24, "time_to_collision": 40, "insert_scan": 16, "track": 4}
"""Times more faults in the largest step within the time, where a lower bound is required, few faults are silent, or the
rate is near the bar."""
FINE = tuple(place / 40 for place in range(1, 41))
"""Steps of functions with a bar: twice those of others."""
LONG = 2_000_000
"""Instructions per call above which a quarter of the faults must do."""
_MACHINE = "<!-- machine-level:begin -->", "<!-- machine-level:end -->"
Row = dict[str, Any]


class Records:
    """Results by key, one JSON object per line; `times` as many injections are learned from as by `mavfi harden`."""

    def __init__(self, path: Path, times: int) -> None:
        self._path, self._times = path, times
        lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        self.known: dict[str, Row] = {row.pop("key"): row for row in map(json.loads, lines)}

    def get(self, key: str) -> Row | None:
        """A result, if it is known."""
        return self.known.get(key)

    def put(self, key: str, row: Row) -> Row:
        """Store a result."""
        self.known[key] = row
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"key": key, **row}) + "\n")
        return row

    def learn(self, seen: Seen) -> list[Injected]:
        """The injections from which the protection of a function is chosen."""
        found = self._injections(seen, self._times)
        silent = sum(one.sdc for one in found)
        if seen.entry in REQUIRED and 0 < silent < ENOUGH:
            found = self._injections(seen, math.ceil(self._times * min(ENOUGH / silent, LEARNED)))
        return found

    def _injections(self, seen: Seen, times: int) -> list[Injected]:
        key = f"learned {times} {seen.variant.ir_sha256}"
        row = self.get(key)
        if row is None:
            row = self.put(key, {"injections": [astuple(one) for one in injections_in(seen, times=times)]})
        return [Injected(*one) for one in row["injections"]]


def choices(target: Target) -> Ladder:
    """All steps of a function: where few faults are silent, a larger one may remove more although none is seen."""
    return every_choice(target, FINE if target.seen.entry in REQUIRED else FRACTIONS)


def code_of(plan: Plan) -> str:
    """Digest of what determines the protected code: not of times, which differ from one measurement to the next."""
    return hashlib.sha256(b"".join(Protection(one).key for one in plan.functions)).hexdigest()


def certificates(
    study: Study, advices: Sequence[Advice], fractions: Sequence[float], faults: int, records: Records
) -> Iterator[tuple[Curve, Step, Row]]:
    """Certify steps of all functions with fresh missions; flights are flown only if something is not known.

    A certificate holds for any prediction of the same code: its verdict is that on the present one.
    """
    for (planner, kernels), advice in zip(study.by_planner().items(), advices, strict=True):
        fresh: list[Any] | None = None
        for curve in advice.curves:
            most = REQUIRED[curve.target.seen.entry][0] if curve.target.seen.entry in REQUIRED else 0.0
            within = max((step.fraction for step in curve.steps if step.time <= most), default=0.0)
            for step in curve.steps[1:]:
                n = faults if curve.target.seen.instructions < LONG * curve.target.seen.total else faults // 4
                planned = planned_of(curve.target, step)
                key = code_of(Plan(functions=(planned,)))
                row = records.get(key)
                wanted = step.fraction in (*fractions, within)
                if row is None and not wanted:
                    continue
                if step.fraction == within:
                    n *= MORE.get(curve.target.seen.entry, 1)
                if row is None or (wanted and row["sdc_after"]["n"] < n):
                    if fresh is None:
                        seen = [observe(scenario, kernels) for scenario in study.fresh(planner)]
                        fresh = merged([one for flown in seen for own in flown.values() for one in own])
                    pairs = pairs_of(fresh, Plan(functions=(planned,)))
                    if not pairs:
                        continue
                    print(planned.function, step.fraction, flush=True)
                    row = records.put(key, certify(pairs[0], n, key).to_json())
                row["verdict"] = verdict_of(Rate(**row["coverage"]), rate_of(planned.predicted))
                yield curve, step, row


def golden(study: Study, plan: Plan, flights: int, records: Records) -> GoldenCheck:
    """Fly golden missions plain and protected, in four environments; sum over these and earlier plans.

    Each planner of the study is flown in all of them.
    """
    for place, (planner, kernels) in enumerate(study.by_planner().items()):
        for environment, seed in product(ENVIRONMENTS, range(200, 200 + flights)):
            key = f"golden {code_of(plan)} {environment} {seed}{f' {planner}' if place else ''}"
            if records.get(key) is None:
                spec = MissionSpec(environment=environment, seed=seed, planner=planner)
                records.put(key, check_golden(resolve(spec), plan, kernels).to_json())
    total = GoldenCheck()
    for key, row in records.known.items():
        if key.startswith("golden "):
            total = total.plus(GoldenCheck(**row))
    return total


def curve_rows(curves: Sequence[Curve], certified: dict[tuple[str, str, float], Row]) -> list[list[str]]:
    """A row for each step of each function; of the fine ones, only for those that are certified."""
    rows = []
    for curve in curves:
        for step in curve.steps[1:]:
            row = certified.get((*curve.target.key, step.fraction))
            if row is None and step.fraction not in FRACTIONS:
                continue
            measured = ["", "", "", "", ""]
            if row is not None:
                before, after, removed = (Rate(**row[key]) for key in ("sdc_before", "sdc_after", "coverage"))
                measured = [str(after.n), interval(before), interval(after), interval(removed), row["verdict"]]
            rows.append([
                f"`{curve.target.seen.entry}` ({', '.join(curve.target.kernels)})", f"{step.fraction:g}",
                f"{growth_of(curve, step):.2f}", f"{step.time:.2f}",
                interval(step.coverage), *measured,
            ])  # fmt: skip
    return rows


def page(
    study: Study, advice: AdviceSummary, required: list[list[str]], curves: Sequence[Curve],
    certified: Sequence[tuple[Curve, Step, Row]], measured: Row,
) -> str:  # fmt: skip
    """The complete page; `required` are the rows of `requirements`."""
    c, earlier = study.campaign, PAGE.read_text(encoding="utf-8") if PAGE.exists() else ""
    by_step = {(*curve.target.key, step.fraction): row for curve, step, row in certified}
    columns, plan = shown(advice_table(advice))
    return (
        banner("make hardening")
        + "# Hardening of the kernels: curves, plans, certificates\n\n"
        + f"{headline(advice)} {' '.join(caveats(advice))}\n\n"
        + f"Campaign `{c.name}` ({', '.join(c.environments)}, {c.missions} missions from seed {c.first_seed}, "
        + f"{c.faults} faults per kernel); {processor()}; {date.today()}. Method: [hardening](../hardening.md).\n\n"
        + "## Requirements\n\n"
        + markdown_grid(HEADINGS, [*required, *rows(measured)])
        + "\n\nThe exhaustive injection of small kernels is also a test (`tests/unit/hardening/test_duplicate.py`). "
        + "Golden digests are compared without charged time: with it the longer latency changes the flight.\n\n"
        + by_processor(required, earlier)
        + at_machine_level(earlier)
        + f"## The plan for {percent(advice.budget, 0)} of a flight's kernel time\n\n"
        + markdown_grid([column.heading for column in columns], plan)
        + "\n\n## Certificate of the shipped plan\n\n<!-- certificate:begin -->\n<!-- certificate:end -->"
        + "\n\n## Curves and certificates\n\n"
        + "Step: share of the cost of full duplication. Certified with n faults in plain and n in "
        + "protected code, on fresh missions; brackets: 95 % intervals.\n\n"
        + markdown_grid(
            ("function", "step", "instr. ×", "time ×", "SDCs removed, predicted", "n", "SDC before",
             "SDC after", "SDCs removed", "prediction"),
            curve_rows(curves, by_step),
        )
        + "\n\nTime: measured by the time stamp counter on baseline x86-64 code. "
        + "Crash rates are IR level, not quoted.\n"
    )  # fmt: skip


def by_processor(required: Sequence[Sequence[str]], earlier: str) -> str:
    """Section of what functions reach on each processor: which step is the largest within a time depends on it."""
    table = f"{date.today()}\n\n{markdown_grid(HEADINGS[:4], of_functions(required))}"
    return (
        "## By processor\n\nThe largest step within a time differs by processor, as the time of a step does. Each was "
        "measured by `make hardening`.\n\n<!-- processors:begin -->\n"
        f"{with_others(table, earlier, 'processors')}\n<!-- processors:end -->\n\n"
    )


def at_machine_level(earlier: str) -> str:
    """Section of register faults in protected code, with the table that `make machine-level` wrote on the page."""
    table = earlier.partition(f"{_MACHINE[0]}\n")[2].partition(f"\n{_MACHINE[1]}")[0]
    return (
        "## At machine level\n\nBits of destination registers flipped in single-stepped calls of plain code, and of "
        "code in which all instructions are duplicated and addresses compared; percent, with intervals; required: at "
        "most 4 % silent in protected code. Removed per call: of the silent corruptions, if each instruction is "
        "equally likely to be hit, of which protected code has more. Measured by `make machine-level`, as the "
        "[reference](../fault-model.md#machine-level-reference), which has the other outcomes.\n\n"
        f"{_MACHINE[0]}\n{table}\n{_MACHINE[1]}\n\n"
    )


def sentence(advice: AdviceSummary) -> str:
    """What the budget buys and what it does not, in one sentence for the README."""
    buys, lost = headline(advice).rstrip("."), caveats(advice)[0].partition(": ")[2]
    return f"{buys} ([curves, plans, certificates](docs/generated/hardening.md)), but buys no missions: {lost}"


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("directory", type=Path)
    parser.add_argument("--learn", type=int, default=3, help="times as many injections per choice as `mavfi harden`")
    parser.add_argument("--faults", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=20.0, help="for how long a function is timed")
    parser.add_argument("--fractions", default="0.5,0.75,1")
    parser.add_argument("--flights", type=int, default=10, help="golden missions per environment")
    parser.add_argument("--budget", type=float, default=0.10)
    given = parser.parse_args()
    study = Study.open(given.directory)
    records = Records(given.directory / "hardening.jsonl", given.learn)
    advices = advise(
        study,
        given.budget,
        lambda text: print(text, flush=True),
        learn=records.learn,
        workers=os.cpu_count() or 1,
        seconds=given.seconds,
        choices=choices,
    )
    advice = summary(study, advices, harm_of(study.runs))
    plan = plan_of(study, advices)
    PLAN.parent.mkdir(exist_ok=True)
    save_plan(plan, PLAN)
    curves = [curve for advice in advices for curve in advice.curves if len(curve.steps) > 1]
    check = golden(study, plan, given.flights, records)
    key = f"measured {code()}"
    measured = records.get(key) or records.put(key, measure(study, plan))
    fractions = [float(text) for text in given.fractions.split(",") if text]
    certified = list(certificates(study, advices, fractions, given.faults, records))
    required = requirements(curves, certified, advice, all_but_map(advices[0]), check)
    PAGE.write_text(page(study, advice, required, curves, certified, measured), encoding="utf-8")
    fill(ROOT / "README.md", {"hardening": sentence(advice)})
    print(f"wrote {PAGE}")


if __name__ == "__main__":
    main()
