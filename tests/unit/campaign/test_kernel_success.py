"""Success under both policies, from records."""

from mavfi.campaign.flights import ALL_BITS, Row
from mavfi.campaign.kernel_success import success_by_policy
from mavfi.campaign.plan import RunSpec
from mavfi.campaign.success import success_by_environment
from mavfi.faults.fault import Fault, FaultSite
from mavfi.reports.comparable import only_comparable

GOLDEN = {"end": "flown", "success": True, "status": "success"}


def row(seed, stage, success=True, died=False, setting="fi", hit=True, end="flown"):
    fault = Fault("instruction", FaultSite("pid", "track"), bit=3, stratum="sign", stage=stage, instruction={"call": 1})
    spec = RunSpec(2, setting, "sparse", seed, "key", "pid", seed, fault)
    record = {"end": end, "success": success, "status": "success" if success else "collision",
              "injections": [{"hit": hit, "time_s": 1.0}]}  # fmt: skip
    if died:
        record["due_end"] = {"status": "due", "success": False}
    return Row(spec, record if end == "flown" else {"end": end}, GOLDEN, GOLDEN)


def rows():
    golden = [Row(RunSpec(1, "golden", "sparse", seed, "key"), GOLDEN, None, GOLDEN) for seed in range(4)]
    return [
        *golden, row(0, "control"), row(1, "control", died=True), row(2, "planning", success=False, died=True),
        row(3, "planning", hit=False), row(4, "planning", end="unknown"), row(0, "control", setting="dr_gaussian"),
    ]  # fmt: skip


def found(table, **wanted):
    (entry,) = [entry for entry in table if all(entry[key] == value for key, value in wanted.items())]
    return entry


def test_a_death_is_a_lost_mission_only_where_missions_end_with_it():
    table = success_by_policy(rows())
    restarted = found(table, setting="fi", stage="all", policy="restart")
    ended = found(table, setting="fi", stage="all", policy="end")
    assert (restarted["successes"], restarted["n"]) == (3, 4)
    assert (ended["successes"], ended["n"]) == (2, 4)
    assert (restarted["died"], restarted["not_hit"], restarted["unknown"]) == (2, 1, 1)
    assert found(table, setting="golden")["successes"] == 4


def test_stages_add_up_to_all_and_stand_beside_no_figure_of_the_paper():
    table = success_by_policy(rows())
    stages = [entry for entry in table if entry["setting"] == "fi" and entry["policy"] == "end"]
    total = found(stages, stage="all")
    assert total["paper"] == 0.883
    parts = [entry for entry in stages if entry["stage"] != "all"]
    assert {entry["stage"] for entry in parts} == {"control", "planning"}
    assert sum(entry["successes"] for entry in parts) == total["successes"]
    assert sum(entry["n"] for entry in parts) == total["n"]
    assert all(entry["paper"] is None for entry in parts)


def test_bits_of_instructions_are_one_population():
    entry = found(success_by_environment(rows()), setting="fi")
    assert (entry["population"], entry["n"]) == (ALL_BITS, 4)


def test_only_the_papers_stack_stands_beside_its_figures():
    analysis = {
        "campaign": {"stack": "hardened", "detectors": {}}, "success": [], "recovery": [], "flight_times": [],
        "overheads": [], "success_by_policy": success_by_policy(rows()),
    }  # fmt: skip
    assert all(entry["paper"] is None for entry in only_comparable(analysis)["success_by_policy"])
