"""Protection at machine level: what is stepped, what is counted, and what is refused."""

import numpy as np
import pytest

from mavfi.campaign.hardening import machine
from mavfi.campaign.hardening.battery import DETECTED
from mavfi.campaign.hardening.certify import Pair
from mavfi.campaign.hardening.kernel import see
from mavfi.campaign.hardening.machine import POINTS, RAYS, MachineLevel, call_of, check_kernel, machine_levels, reduced
from mavfi.errors import BadInputError
from mavfi.faults.instruction.variant import signature_of
from mavfi.hardening.full import full_plan
from mavfi.hardening.plan import Plan
from tests.unit.campaign.hardening.kernels import calls, smooth
from tests.unit.faults.register.tracing import require_tracing


@pytest.fixture(scope="module")
def pair():
    return Pair.of(see(smooth, calls()), full_plan("pid", smooth, signature_of(calls()[0])))


@pytest.mark.slow
def test_protected_machine_code_detects_what_was_silent(pair):
    require_tracing()
    (found,) = machine_levels([pair], "pid", 60, lambda _: None)
    before, after = found.rates("sdc")
    detected = found.rates(DETECTED)
    assert before.n == after.n == 60
    assert before.rate > 0.2 and after.rate < before.rate / 3
    assert detected[0].rate == 0.0 and detected[1].rate > 0.2
    assert found.protected_sites > 1.5 * found.sites > 0


def test_a_kernel_without_short_calls_is_refused(pair, monkeypatch):
    monkeypatch.setattr(machine, "LONGEST", 5)
    with pytest.raises(BadInputError, match="--machine: 'pid': its calls are too long"):
        machine_levels([pair], "pid", 60, lambda _: pytest.fail("nothing is injected"))


def test_coverage_is_per_call_not_per_instruction():
    found = MachineLevel("pid", "m.track", "f8", {"sdc": 50, "masked": 50}, {"sdc": 10, "detected": 90}, 100, 300)
    assert found.coverage.rate == pytest.approx(1 - 3 * 0.1 / 0.5)
    data = found.to_json()
    assert data["sdc_before"]["rate"] == 0.5 and data["crash_after"]["rate"] == 0.0
    assert data["detected_after"]["low"] < 0.9 < data["detected_after"]["high"] and data["sites"] == 100


def test_the_longest_call_that_can_be_stepped_is_taken(pair, monkeypatch):
    several = [(np.ones(n), np.zeros(n)) for n in (3, 9, 6)]
    own = Pair(see(smooth, several), pair.planned, pair.plain, pair.guarded)
    assert len(call_of(own)[0]) == 9
    counts = {len(args[0]): machine.instructions_of(own.seen, [args])[0] for args in several}
    monkeypatch.setattr(machine, "LONGEST", counts[6])
    assert len(call_of(own)[0]) == 6
    monkeypatch.setattr(machine, "LONGEST", counts[3] - 1)
    assert call_of(own) is None


def test_long_calls_are_reduced_with_their_types():
    rows = np.arange(300.0).reshape(100, 3)
    cloud = (np.arange(100.0), rows, np.eye(3), np.zeros(3), 9.0, rows.copy())
    fewer = reduced("back_project", cloud)
    assert [len(fewer[place]) for place in (0, 1, 5)] == [RAYS] * 3 and signature_of(fewer) == signature_of(cloud)
    path = (0, rows, np.zeros(3), rows, 40, 1.5)
    ahead = reduced("time_to_collision", path)
    assert ahead[3].tolist() == rows[40 : 40 + POINTS].tolist() and ahead[4:] == (0, 1.5)
    assert signature_of(ahead) == signature_of(path)


def test_a_kernel_that_is_not_duplicated_or_not_studied_is_refused(pair):
    plan = Plan(functions=(pair.planned,))
    check_kernel(plan, "pid", ("pid", "octomap"))
    with pytest.raises(BadInputError, match="--machine: 'octomap': allowed: pid"):
        check_kernel(plan, "octomap", ("pid", "octomap"))
    with pytest.raises(BadInputError, match="--machine: 'pid': allowed: none"):
        check_kernel(plan, "pid", ("octomap",))
