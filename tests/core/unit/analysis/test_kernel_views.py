"""Tables of faults in instructions, and of faults in registers, from records made by hand."""

from dataclasses import replace

import pytest

from mavfi.analysis.views import table, views_for
from mavfi.record import KernelEffect
from tests.core.unit.analysis.handmade import (
    GOLDEN,
    INSTRUCTION,
    UNKNOWN,
    died,
    flown,
    golden,
    injected,
    runs,
)

PROTECTED = KernelEffect("detected")
PLANNING = replace(INSTRUCTION, kernel="rrt_connect", entry="plan_rrt_connect", value_class="address", stratum="other")
FIRST = {"state": "control.command", "field": "vx", "element": None, "elements": 1, "largest": 2.0}
ABOUT = {"each": "stage", "kernels": ["pid", "rrt_connect"], "which": "all"}


def silent(success=True, first=None, **changes):
    return flown(success, kernel=KernelEffect("sdc", "", first), **changes)


@pytest.fixture
def kernel_runs():
    faulty = [
        injected(0, silent(first=FIRST), INSTRUCTION, target="pid"),
        injected(1, died(), INSTRUCTION, target="pid"),
        injected(2, died("hang", success=False), PLANNING, target="rrt_connect"),
        injected(3, flown(activated=False, digest="g", kernel=KernelEffect("masked")), PLANNING, target="rrt_connect"),
        injected(4, UNKNOWN, PLANNING, target="rrt_connect"),
        injected(0, silent(), INSTRUCTION, target="pid", arm="gaussian"),
    ]
    counts = {"pid": {"instructions": 100, "calls": 10, "lines": []}}
    without = [golden(seed, replace(GOLDEN, counts=counts)) for seed in range(5)]
    return runs(*without, golden(0, arm="gaussian"), *faulty, **ABOUT)


def test_a_death_is_a_lost_mission_only_where_missions_end_with_it(kernel_runs):
    rows = {(row[0], row[1]): row[2] for row in table(kernel_runs, "instructions_as_in_the_paper").rows}
    restarted, ended = rows["Injection run", "here, node restarts"], rows["Injection run", "here, mission ends"]
    assert (restarted.successes, restarted.n, ended.successes, ended.n) == (3, 4, 2, 4)
    assert rows["Golden run", "here"].successes == 5
    assert (rows["Golden run", "paper"], rows["Injection run", "paper"]) == (0.95, 0.883)
    notes = table(kernel_runs, "instructions_as_in_the_paper").notes
    assert "faults that found no such call or were not activated, kept in every rate: fi 1, dr_gaussian 0" in notes
    assert any("control: pid; planning: rrt_connect" in note for note in notes)
    assert "1 flights could not be judged (unknown) and are left out" in notes


def test_what_kernels_did(kernel_runs):
    pid, planner = table(kernel_runs, "kernel_effects").entries()
    assert (pid["kernel"], pid["n"], pid["sdc"].successes, pid["due"].successes) == ("pid", 2, 1, 1)
    assert (planner["n"], planner["masked"].successes, planner["due_kinds"]) == (2, 1, "0 / 1 / 0")


def test_protected_and_plain_code_are_compared_as_samples():
    plain = [injected(0, silent(), INSTRUCTION), injected(1, died(success=False), INSTRUCTION)]
    assert "kernel_effects_by_setting" not in views_for(runs(golden(0), golden(1), *plain)), "nothing is protected"
    campaign_runs = [
        injected(0, flown(kernel=PROTECTED), INSTRUCTION, arm="full"),
        injected(1, died(), INSTRUCTION, arm="full"),
        injected(2, UNKNOWN, INSTRUCTION, arm="full"),
    ]
    base = [golden(seed, arm=arm) for seed in range(4) for arm in ("", "full")]
    rows = table(runs(*base, *plain, *campaign_runs), "kernel_effects_by_setting").entries()
    row_of_setting = {row["setting"]: row for row in rows if row["kernel"] == "pid"}
    assert (
        row_of_setting["fi"]["sdc"].successes
        == row_of_setting["fi"]["due"].successes
        == row_of_setting["dr_full"]["found"].successes
        == 1
    )
    assert (
        row_of_setting["fi"]["n"] == row_of_setting["dr_full"]["n"] == 2
        and row_of_setting["dr_full"]["sdc"].successes == 0
    )
    assert (row_of_setting["fi"]["success_due"].successes, row_of_setting["dr_full"]["success_due"].successes) == (0, 1)
