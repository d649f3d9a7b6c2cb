"""Views of register faults in a firmware, on runs made by hand."""

from dataclasses import replace

from mavfi.campaign.analysis.views import table, views_for
from mavfi.faults.fault import RegisterFault
from mavfi.flight_log import Injection, KernelEffect
from mavfi.flight_record import End
from tests.unit.campaign.analysis.handmade import GOLDEN, REGISTER, flown, golden, injected, runs

FAULT = RegisterFault(node="firmware", walk=3000, seed=1)


def struck(register="rax", symbol="scheduler.part.0+0x1c", time_s=3.0, **changes):
    one = Injection(
        "register", register, time_s, 5, "0x0", "0x20", True, details={"register": register, "symbol": symbol}
    )
    return flown(changes.pop("success", True), **{**changes, "injections": (one,)})


def lost(effect):
    return replace(struck(), end=End.DUE, status="collision", kernel=KernelEffect(effect, "SIGSEGV"))


def five():
    records = [struck(digest=GOLDEN.digest), struck("xmm3"), struck(success=False), lost("crash"), lost("hang")]
    return runs(*(golden(seed) for seed in range(1, 6)),
                *(injected(seed, record, FAULT, target="all") for seed, record in enumerate(records, 1)))  # fmt: skip


def counts(found):
    heads = [column.key for column in found.columns]
    return {row[0]: dict(zip(heads[1:], (getattr(cell, "successes", cell) for cell in row[1:]), strict=True))
            for row in found.rows}  # fmt: skip


def test_each_run_has_one_outcome():
    found = counts(table(five(), "firmware_faults"))
    assert found["in all"]["n"] == 5
    assert [found["in all"][key] for key in ("identical", "arrives", "lost", "ends", "hangs")] == [1, 1, 1, 1, 1]
    assert found["FP (XMM, YMM)"]["n"] == 1
    assert found["FP (XMM, YMM)"]["arrives"] == 1
    assert found["general"]["n"] == 4


def test_functions_are_named_without_what_the_compiler_added():
    assert counts(table(five(), "firmware_functions")).keys() == {"scheduler"}


def test_phases_are_thirds_of_the_golden_flight():
    third = GOLDEN.flight_time_s / 3
    records = [struck(time_s=time_s) for time_s in (0.0, 0.9 * third, 1.1 * third, 2.1 * third, 3 * third)]
    own = runs(*(golden(seed) for seed in range(1, 6)),
               *(injected(seed, record, FAULT, target="all") for seed, record in enumerate(records, 1)))  # fmt: skip
    found = counts(table(own, "firmware_phases"))
    assert {part: row["n"] for part, row in found.items()} == {"first": 2, "second": 1, "last": 2}


def test_only_faults_in_a_firmware_have_these_views_and_none_of_a_foreign_node():
    def names(own):
        return {one.name for one in views_for(own)}

    node = runs(golden(1), injected(1, flown(), REGISTER, target="general"))
    assert {"firmware_faults", "firmware_phases", "firmware_functions"} <= names(five())
    assert "register_effects" not in names(five())
    assert "register_effects" in names(node)
    assert "firmware_faults" not in names(node)
