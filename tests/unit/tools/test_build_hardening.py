"""The README's sentence on hardening, and the table of requirements."""

from dataclasses import dataclass
from types import SimpleNamespace

from mavfi.campaign.analysis.pairs import mcnemar
from mavfi.campaign.hardening.advise import Curve, Step
from mavfi.campaign.hardening.golden import GoldenCheck
from mavfi.campaign.hardening.learned import Injected
from mavfi.hardening.choose import NOTHING
from tools.hardening_requirements import HEADINGS, requirements
from tools.markers import GENERATED, ROOT


def test_the_readme_says_what_the_page_says():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    block = readme.partition("<!-- hardening:begin -->")[2].partition("<!-- hardening:end -->")[0].strip()
    answer = block.partition("): ")[2]
    assert answer.startswith("Protect ") and "It does not buy missions" in answer
    assert answer in (GENERATED / "hardening.md").read_text(encoding="utf-8")


@dataclass
class Function:
    seen: SimpleNamespace
    kernels: tuple[str, ...] = ("rrt_connect",)


def certified(entry, time, rate, low, predicted=0.95):
    step = Step(0.6, NOTHING, time, [(Injected(0, i, True, str(i)), i < 100 * predicted) for i in range(100)])
    target = Function(SimpleNamespace(entry=entry))
    curve = Curve(target, 1.0, 0.1, (Step(0.0, NOTHING, 1.0, []), step, Step(1.0, NOTHING, 2.2, [])))
    coverage = {"rate": rate, "low": low, "high": 1.0, "n": 200}
    return curve, step, {"coverage": coverage, "sdc_after": {"n": 200}, "verdict": "confirmed"}


FLOWN = GoldenCheck(92, 92, 20_000, 0)


def table(*rows, compared=(), check=FLOWN):
    advice = {"budget": 0.1, "spent": 0.09, "coverage": {"rate": 0.3, "low": 0.2, "high": 0.4}, "functions": [
        {"kernel": "pid", "entry": "track", "share": 0.2, "steps": [{"time": 1.6, "chosen": False}]},
        {"kernel": "octomap", "entry": "insert_scan", "share": 0.8, "steps": [{"time": 2.6, "chosen": False}]},
    ]}  # fmt: skip
    found = requirements([curve for curve, *_ in rows], rows, compared, advice, check)
    assert all(len(row) == len(HEADINGS) for row in found)
    return {row[0].strip("`"): dict(zip(HEADINGS, row, strict=True)) for row in found}


def test_a_requirement_is_met_by_rate_and_lower_bound():
    assert table(certified("plan_rrt_connect", 1.1, 0.98, 0.95))["plan_rrt_connect"]["met"] == "yes"
    missed = table(certified("plan_rrt_connect", 1.1, 0.98, 0.72))["plan_rrt_connect"]
    assert missed["met"] == "no" and missed["what limits"].startswith("n = 200 faults cannot reach")
    missed = table(certified("plan_rrt_connect", 1.1, 0.9, 0.8))["plan_rrt_connect"]
    assert missed["what limits"].startswith("the next step takes ×2.20, predicted: ")
    assert table(certified("track", 1.4, 0.98, 0.95))["track"]["met"] == "no", "beyond its time"
    best = table(certified("back_project", 1.12, 0.2, 0.1))["back_project"]
    assert best["met"] == "best found" and "no step between ×1.12 and ×2.20 was tried" in best["what limits"]


def test_both_readings_of_the_prediction_are_told():
    rows = [certified("track", 1.2, 0.95 if i < 14 else 0.5, 0.4) for i in range(20)]
    found = table(*rows)["prediction"]
    assert found["met"] == "yes; no" and "20 of 20 plans" in found["measured"] and "14 of 20" in found["measured"]


def test_ways_to_choose_are_counted_by_kernel():
    won = mcnemar([True] * 50, [False] * 50)
    kernels = ("pid", "octomap", "rrt", "rrt_connect", "rrt_connect")
    rows = [{"function": f"f{i}", "kernel": name, "tests": {"opcode": won, "random": won}}
            for i, name in enumerate(kernels)]  # fmt: skip
    found = table(compared=rows)["choice"]
    assert found["met"] == "no" and found["measured"].startswith("5 of 5 functions, of 4 kernels: f0, f1")


def test_the_budget_and_the_golden_flights_are_judged():
    found = table()
    assert found["--budget 0.10` of a flight's kernel time"]["what limits"] == "not in full, which adds: track 12.0 %"
    assert found["golden digests with any plan; false alarms"]["met"] == "yes"
    assert table(check=GoldenCheck(92, 91, 20_000, 0))["golden digests with any plan; false alarms"]["met"] == "no"
