"""A function as target of the choice: rates from injections, cross-validation, and what a summary says of it."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from mavfi.analysis.statistics import wilson
from mavfi.extras.hardening.advise import Advice, Curve, CurveStep, choices_of, every_choice, planned_of
from mavfi.extras.hardening.battery import Battery
from mavfi.extras.hardening.certify import Certification, FunctionPair, certified_plan, certify, with_certified
from mavfi.extras.hardening.observed import GoldenCheck
from mavfi.extras.hardening.plan import Coverage, FunctionPlan, ProtectionPlan
from mavfi.extras.hardening.summary import Harm, summary
from mavfi.extras.hardening.target import Injected, injections_in, targets_of
from mavfi.faults.levels.instruction.variant import signature_of
from tests.extras.hardening.choice.kernels import calls, see, smooth
from tools.full_protection import full_plan


@pytest.fixture(scope="module")
def target():
    """Injections of which those in results of multiplications are silent corruptions."""
    seen = see(smooth, calls(12), missions=6)
    battery = Battery("smooth", smooth, seen.variant, seen.calls)
    (found,) = targets_of({"pid": [seen]})
    found.injections = [
        Injected(
            place.block,
            place.offset,
            battery.site(place.block, place.offset).opcode == "fmul",
            seen.missions[place.call],
        )
        for place in battery.draw(np.random.default_rng(4), 300)
    ]
    return found


def test_expected_corruptions_are_those_of_the_injected_instructions(target):
    by_opcode = {}
    for _, row, _, mass in target.masses:
        by_opcode[row.opcode] = by_opcode.get(row.opcode, 0.0) + mass
    assert max(by_opcode, key=by_opcode.get) == "fmul" and by_opcode["fmul"] > 0.7 * target.sdc_mass
    rate = sum(one.sdc for one in target.injections) / len(target.injections)
    assert target.sdc_mass == pytest.approx(rate * target.seen.instructions, rel=0.15)


def test_a_mission_judges_choices_that_know_neither_its_faults_nor_its_blocks():
    """Mission 0 alone has values, so what is in the loop over them the choice of the others does not duplicate."""
    nothing = [(np.zeros(0), np.zeros(0)) for _ in range(5)]
    seen = see(smooth, [(np.full(9, 3.0), np.zeros(9)), *nothing], missions=6)
    (target,) = targets_of({"pid": [seen]})
    by_mission = np.array([part.executions for part in seen.parts])
    loop = int(by_mission[0].argmax())
    everywhere = int(np.flatnonzero(by_mission.all(axis=0))[0])
    target.injections = [
        Injected(loop, 0, True, "dense-0"),
        *(Injected(everywhere, 0, True, part.mission) for part in seen.parts),
    ]
    removed = dict(target.judged(1.0))
    assert target.site_of(target.injections[0]) in target.sites(target.chooser.full)
    assert [removed[injected] for injected in target.injections] == [False] + [True] * 6
    assert 0.5 < seen.unseen_share < 1


def test_sites_are_those_of_the_parsed_module(target):
    sites = target.sites(target.chooser.full)
    assert all(target.site_of(one) in sites for one in target.injections if one.sdc)
    planned = planned_of(target, CurveStep(1.0, target.chooser.full, 1.234, choices_of(target)[-1][2]))
    assert set(planned.sites) == sites and planned.time == 1.234 and planned.predicted.estimate == 1.0
    assert all(line.split(":")[0].endswith("kernels.py") for line in planned.lines if not line.startswith("numba"))


@dataclass
class Study:
    @dataclass
    class Named:
        name: str = "tiny"

    campaign: Named
    digest: str = "0" * 64
    kernels: tuple[str, ...] = ("pid",)
    complete: bool = False
    selected: tuple[str, ...] = ("pid",)
    studied: dict[str, tuple[int, int]] = field(default_factory=lambda: {"dense": (1, 2)})


def test_a_summary_adds_up(target):
    ladder = every_choice(target, (0.5, 1.0))
    steps = tuple(CurveStep(fraction, choice, 1 + fraction, judged) for fraction, choice, judged in ladder)
    curve = Curve(target, 1.0, 0.2, steps)
    assert [step.fraction for step in steps] == [0.0, 0.5, 1.0]
    advice = Advice(0.5, (curve,), (1,))
    found = summary(Study(Study.Named()), [advice], Harm(wilson(0, 9), wilson(1, 3), wilson(3, 20)))
    (function,), (kernel,) = found.functions, found.kernels
    assert sum(function.escapes.values()) == pytest.approx(1.0)
    assert sum(line.sdc for line in function.lines) == pytest.approx(1.0)
    removed = sum(line.sdc * line.protected for line in function.lines)
    assert removed == pytest.approx(function.escapes["protected"])
    assert (found.complete, found.selected, found.addresses) == (False, ("pid",), False)
    assert found.spent == kernel.added == pytest.approx(0.2 * 0.5) and kernel.time == pytest.approx(1.5)
    assert [step.chosen for step in function.steps] == [one.fraction == 0.5 for one in steps]


def test_a_plan_keeps_the_certificate_of_the_same_code(target):
    whole = FunctionPlan(
        kernel="pid",
        function=target.name,
        signature=target.seen.signature_text,
        ir_sha256=target.seen.variant.ir_sha256,
        sites=tuple(target.sites(target.chooser.full)),
        time=1.4,
    )
    plan, found = ProtectionPlan(functions=(whole,)), Coverage(estimate=0.9, low=0.8, high=0.95)
    pair = FunctionPair.of(target.seen, whole)
    certified = certified_plan(plan, Certification(plan.digest, 20, (), (certify(pair, 20),), GoldenCheck(1, 1, 1, 0)))
    assert certified.functions[0].certified.estimate > 0.5 and certified.digest == plan.digest
    earlier = ProtectionPlan(functions=(whole.model_copy(update={"certified": found, "time": 1.1}),))
    assert with_certified(plan, earlier).functions[0].certified == found
    other = ProtectionPlan(functions=(whole.model_copy(update={"certified": found, "sites": whole.sites[1:]}),))
    assert with_certified(plan, other).functions[0].certified is None


@pytest.mark.long
def test_choice_and_certificate_count_the_same_corruptions():
    """A function's result that its caller would mask is a corruption for both."""
    pair = FunctionPair.of(see(smooth, calls(), missions=4), full_plan("pid", smooth, signature_of(calls()[0])))
    learned = injections_in(pair.seen)
    rate = wilson(sum(one.sdc for one in learned), len(learned))
    measured = certify(pair, 60).sdc_before
    assert rate.rate > 0.2
    assert rate.low < measured.high and measured.low < rate.high, "the intervals overlap: two samples of one rate"
    assert {one.world for one in learned} == {f"dense-{number}" for number in range(4)}
