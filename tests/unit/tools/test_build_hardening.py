"""The README's sentence on hardening, and the table of requirements."""

from dataclasses import dataclass
from types import SimpleNamespace

import pytest

from mavfi.campaign.analysis.statistics import Rate
from mavfi.campaign.hardening.advise import Curve, Step
from mavfi.campaign.hardening.golden import GoldenCheck
from mavfi.campaign.hardening.learned import Injected
from mavfi.hardening.choose import NOTHING
from mavfi.hardening.plan import Plan
from tools import build_hardening
from tools.hardening_measured import rows
from tools.hardening_requirements import HEADINGS, Bought, requirements
from tools.markers import GENERATED, ROOT


def test_the_readme_says_what_the_page_says():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    block = readme.partition("<!-- hardening:begin -->")[2].partition("<!-- hardening:end -->")[0].strip()
    page = (GENERATED / "hardening.md").read_text(encoding="utf-8")
    buys, _, lost = block.partition(
        " ([curves, plans, certificates](docs/generated/hardening.md)), but buys no missions: "
    )
    assert buys.startswith("Protect ") and f"{buys}. It does not buy missions: {lost}" in page


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


REST = Bought(0.15, Rate(60, 0.15, 0.1, 0.2))


def table(*rows, check=FLOWN, rest=REST):
    advice = SimpleNamespace(budget=0.1, spent=0.09, coverage=Rate(60, 0.3, 0.2, 0.4))
    found = requirements([curve for curve, *_ in rows], rows, advice, rest, check)
    assert all(len(row) == len(HEADINGS) for row in found)
    return {row[0].strip("`"): dict(zip(HEADINGS, row, strict=True)) for row in found}


def test_a_requirement_is_met_by_rate_and_lower_bound():
    assert table(certified("plan_rrt_connect", 1.1, 0.98, 0.95))["plan_rrt_connect"]["met"] == "yes"
    missed = table(certified("plan_rrt_connect", 1.1, 0.98, 0.72))["plan_rrt_connect"]
    assert missed["met"] == "no" and missed["what limits"].startswith("n = 200 faults cannot reach")
    missed = table(certified("plan_rrt_connect", 1.1, 0.9, 0.8))["plan_rrt_connect"]
    assert missed["what limits"].startswith("the next step takes ×2.20, predicted: ")
    missed = table(certified("time_to_collision", 1.19, 0.963, 0.931))["time_to_collision"]
    assert "not in calls of `floor`; the next step takes ×2.20, predicted: " in missed["what limits"]
    assert table(certified("track", 1.4, 0.98, 0.95))["track"]["met"] == "no", "beyond its time"
    best = table(certified("back_project", 1.12, 0.2, 0.1))["back_project"]
    assert best["met"] == "best found" and "no step between ×1.12 and ×2.20 was tried" in best["what limits"]


def test_both_readings_of_the_prediction_are_told():
    rows = [certified("track", 1.2, 0.95 if i < 14 else 0.5, 0.4) for i in range(20)]
    found = table(*rows)["prediction"]
    assert found["met"] == "yes; no" and "20 of 20 plans" in found["measured"] and "14 of 20" in found["measured"]


def test_undecided_plans_count_in_no_agreement():
    rows = [certified("track", 1.2, 0.95, 0.4) for _ in range(24)]
    for *_, row in rows[:3]:
        row["verdict"] = "undecided"
    found = table(*rows)["prediction"]
    assert "21 of 21 plans (3 more are undecided)" in found["measured"] and found["met"].startswith("yes")
    for *_, row in rows[:5]:
        row["verdict"] = "undecided"
    assert table(*rows)["prediction"]["met"].startswith("no"), "fewer than 20"


def test_the_budget_and_the_golden_flights_are_judged():
    found = table()
    budget = found["--budget 0.10` of a flight's kernel time"]
    assert budget["met"] == "yes" and "15.0 % [10.0, 20.0] for 15.0 %" in budget["measured"]
    better = Bought(0.15, Rate(60, 0.25, 0.2, 0.3))
    assert table(rest=better)["--budget 0.10` of a flight's kernel time"]["met"] == "no", "within its interval"
    assert found["golden digests with any plan; false alarms"]["met"] == "yes"
    assert table(check=GoldenCheck(92, 91, 20_000, 0))["golden digests with any plan; false alarms"]["met"] == "no"


MEASURED = {
    "advice_s": 53.2, "build_s": {"pid": 0.1, "rrt": 0.4},
    "anew_s": {"pid": 2.5, "rrt": 1.5},
    "exhaustive": {"walk": {"detected": 9, "masked": 4}, "mean_square": {"detected": 7}},
    "without_addresses": {"walk": {"detected": 8, "crash": 5}, "mean_square": {"detected": 7}},
}  # fmt: skip


def test_times_and_all_faults_are_judged():
    found = {row[0]: dict(zip(HEADINGS, row, strict=True)) for row in rows(MEASURED)}
    assert [row["met"] for row in found.values()] == ["yes", "yes", "", "yes", "yes"]
    assert found["`mavfi harden`"]["measured"] == "53 s"
    assert found["protected code of a kernel, from the cache"]["measured"] == "0.40 s (rrt, the slowest)"
    assert found["the same, from the IR of the kernel: once per machine"]["measured"] == "2.5 s (pid, the slowest)"
    assert found["every bit of every dynamic instruction of walk and mean_square"]["measured"] == "5 crash, 15 detected"
    late = {"advice_s": 61.0, "build_s": {"pid": 1.2}, "without_addresses": {"walk": {"detected": 9, "sdc": 1}}}
    late["exhaustive"] = {"walk": {"detected": 9, "hang": 1}}
    assert [row[3] for row in rows(MEASURED | late)] == ["no", "no", "", "no", "no"]


def test_fine_steps_have_a_row_if_they_are_certified(monkeypatch):
    monkeypatch.setattr(build_hardening, "growth_of", lambda *_: 1.5)
    target = SimpleNamespace(key=("track", "()"), seen=SimpleNamespace(entry="track"), kernels=("pid",))
    steps = tuple(Step(place / 40, NOTHING, 1.1, []) for place in range(5))
    rate = {"rate": 0.5, "low": 0.4, "high": 0.6, "n": 10}
    row = {"sdc_before": rate, "sdc_after": rate, "coverage": rate, "verdict": "confirmed"}
    found = build_hardening.curve_rows([Curve(target, 1.0, 0.1, steps)], {("track", "()", 0.025): row})
    assert [(step, verdict) for _, step, *_, verdict in found] == [("0.025", "confirmed"), ("0.05", ""), ("0.1", "")]


@pytest.mark.parametrize(
    ("entry", "silent", "asked"),
    [
        ("time_to_collision", 100, [3, 9]),
        ("time_to_collision", 10, [3, 12]),  # four times as many at most
        ("time_to_collision", 300, [3]),
        ("time_to_collision", 0, [3]),
        ("plan_rrt", 100, [3]),  # no bar
    ],
)
def test_functions_with_a_bar_are_injected_until_enough_are_silent(monkeypatch, tmp_path, entry, silent, asked):
    made = []

    def injections(seen, times):
        made.append(times)
        return [Injected(0, place, place < silent * times / 3, "0") for place in range(1000 * times)]

    monkeypatch.setattr(build_hardening, "injections_in", injections)
    seen = SimpleNamespace(entry=entry, variant=SimpleNamespace(ir_sha256="f00"))
    found = build_hardening.Records(tmp_path / "r.jsonl", 3).learn(seen)
    assert made == asked and len(found) == 1000 * asked[-1]
    assert build_hardening.Records(tmp_path / "r.jsonl", 3).learn(seen) == found and made == asked, "kept in the file"


def test_every_planner_of_the_study_is_flown_golden(monkeypatch, tmp_path):
    flown = []

    def check(scenario, plan, kernels):
        flown.append((scenario.environment.name, scenario.seed, scenario.planner.name))
        assert scenario.planner.name in kernels
        return GoldenCheck(1, 1, 10, 0)

    monkeypatch.setattr(build_hardening, "check_golden", check)
    planners = {"rrt_connect": ("pid", "rrt_connect"), "rrt": ("pid", "rrt"), "rrt_star": ("pid", "rrt_star")}
    study, records = SimpleNamespace(by_planner=lambda: planners), build_hardening.Records(tmp_path / "r.jsonl", 1)
    for _ in range(2):  # what is known is not flown again
        assert build_hardening.golden(study, Plan(), 2, records) == GoldenCheck(24, 24, 240, 0)
    assert len(flown) == len(set(flown)) == 24 and {planner for *_, planner in flown} == set(planners)


def test_the_section_by_processor_has_the_functions_and_keeps_other_processors():
    page = "<!-- processors:begin -->\n**another one**\n\n2026-01-01\n\n| x |\n<!-- processors:end -->"
    digests = ["golden digests with any plan", "equal", "720 of 720", "yes", ""]
    track = ["`track`", "≥ 85 % at ≤ ×1.30", "70.0 % at ×1.30", "no", "why"]
    section = build_hardening.by_processor([digests, track], page)
    assert "| `track` | ≥ 85 % at ≤ ×1.30 | 70.0 % at ×1.30 | no |" in section and "720" not in section
    assert section.index("70.0 %") < section.index("**another one**\n\n2026-01-01\n\n| x |")


def test_the_section_at_machine_level_keeps_what_was_measured():
    page = (GENERATED / "hardening.md").read_text(encoding="utf-8")
    section = build_hardening.at_machine_level(page)
    assert section in page and build_hardening.at_machine_level(section) == section
    assert all(f"| {kernel} | " in section for kernel in ("pid", "point_cloud", "collision_check"))


def test_the_page_has_its_own_processor_in_the_section():
    page = (GENERATED / "hardening.md").read_text(encoding="utf-8")
    processor, date = page.partition("faults per kernel); ")[2].partition(".")[0].split("; ")
    assert f"**{processor}**\n\n{date}\n" in page.partition("## By processor")[2]
