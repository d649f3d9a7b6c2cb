"""Views of register faults in a firmware, on runs made by hand."""

from dataclasses import replace

import pytest

from mavfi.analysis.views import table
from mavfi.extras.registers.fault import RegisterFault
from mavfi.record import End, Injection, KernelEffect
from tests.core.unit.analysis.handmade import GOLDEN, flown, golden, injected, runs

FAULT = RegisterFault(node="firmware", walk=3000, seed=1)


def struck(register="rax", symbol="scheduler.part.0+0x1c", time_s=3.0, **changes):
    injection = Injection(
        "register", register, time_s, 5, "0x0", "0x20", True, details={"register": register, "symbol": symbol}
    )
    return flown(changes.pop("success", True), **{**changes, "injections": (injection,)})


def lost(effect, **changes):
    return replace(struck(**changes), end=End.DUE, status="collision", kernel=KernelEffect(effect, "SIGSEGV"))


def each_outcome():
    """A run with each outcome of a fault."""
    records = [struck(digest=GOLDEN.digest), struck("xmm3"), struck(success=False), lost("crash"), lost("hang")]
    return runs(
        *(golden(seed) for seed in range(1, 6)),
        *(injected(seed, record, FAULT, target="all") for seed, record in enumerate(records, 1)),
    )


CALM = {"tilt": 0.3, "attitude": 0.02, "velocity": 0.4, "yaw_rate": 0.05}


def measured(**errors):
    """Keys of a record with the errors of the flight."""
    return {"extra": {"control": CALM | errors}}


def each_class():
    """A run with each class of control, from bit-identical to a hang."""
    records = [
        struck("xmm1", digest=GOLDEN.digest, **measured()),
        struck("xmm2", **measured()),
        struck("rdx", time_s=30.0, **measured(attitude=0.1)),
        struck("rcx", success=False, time_s=49.0, **measured(velocity=4.7, tilt=0.1)),
        lost("crash", **measured()),
        lost("hang", **measured()),
    ]
    return runs(
        *(golden(seed, replace(GOLDEN, **measured())) for seed in range(1, 7)),
        *(injected(seed, record, FAULT, target="all") for seed, record in enumerate(records, 1)),
    )


def counts(shown_table):
    heads = [column.key for column in shown_table.columns]
    return {
        row[0]: dict(zip(heads[1:], (getattr(cell, "successes", cell) for cell in row[1:]), strict=True))
        for row in shown_table.rows
    }


def test_each_run_has_one_outcome():
    counted = counts(table(each_outcome(), "firmware_faults"))
    assert counted["in all"]["n"] == 5
    assert [counted["in all"][key] for key in ("identical", "arrives", "lost", "ends", "hangs")] == [1, 1, 1, 1, 1]
    assert counted["FP (XMM, YMM)"]["n"] == 1
    assert counted["FP (XMM, YMM)"]["arrives"] == 1
    assert counted["general"]["n"] == 4


def test_functions_are_named_without_what_the_compiler_added():
    assert counts(table(each_outcome(), "firmware_functions")).keys() == {"scheduler"}


def test_phases_are_thirds_of_the_golden_flight():
    third = GOLDEN.flight_time_s / 3
    records = [struck(time_s=time_s) for time_s in (0.0, 0.9 * third, 1.1 * third, 2.1 * third, 3 * third)]
    campaign_runs = runs(
        *(golden(seed) for seed in range(1, 6)),
        *(injected(seed, record, FAULT, target="all") for seed, record in enumerate(records, 1)),
    )
    counted = counts(table(campaign_runs, "firmware_phases"))
    assert {part: row["n"] for part, row in counted.items()} == {"first": 2, "second": 1, "last": 2}


def test_each_mission_has_one_class_of_control():
    counted = counts(table(each_class(), "firmware_control"))
    keys = ["identical", "slight", "degraded", "lost", "ends", "hangs"]
    assert [counted["in all"][key] for key in keys] == [1, 1, 1, 1, 1, 1]
    assert [counted["FP (XMM, YMM)"][key] for key in keys] == [1, 1, 0, 0, 0, 0]


def test_classes_are_shown_by_third_of_the_golden_flight():
    counted = counts(table(each_class(), "firmware_control_phases"))
    assert (counted["second"]["degraded"], counted["last"]["lost"], counted["first"]["n"]) == (1, 1, 4)


def test_classes_come_from_harmless_to_worst_with_their_largest_errors():
    counted = counts(table(each_class(), "firmware_classes"))
    assert list(counted) == ["bit-identical", "slight", "degraded", "loss of control", "process ends", "hang"]
    assert counted["degraded"]["attitude"] == pytest.approx(5.73, abs=0.01)
    assert (counted["loss of control"]["velocity"], counted["loss of control"]["success"]) == (4.7, 0)
    assert counted["loss of control"]["time"] is None
    assert counted["slight"]["time"] == 0.0
