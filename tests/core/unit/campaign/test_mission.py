"""The unit of work: what one mission gives, as a function of its plan alone."""

import os
import pickle
from dataclasses import replace

import pytest

from mavfi.campaign import alone
from mavfi.campaign.alone import ATTEMPTS_ALONE
from mavfi.campaign.mission import MissionPlan, fly_mission
from mavfi.campaign.plan import CompletedRun, Planned
from mavfi.campaign.resolve import resolve
from mavfi.errors import MachineError
from mavfi.ir.forked import WALL_CLOCK, ChildEnd
from mavfi.record import End
from tests.core.unit.analysis.handmade import injected
from tests.core.unit.campaign import fakes
from tests.core.unit.campaign.fakes import DEADLY, TROUBLE, deaths, small
from tests.night import at_night

MISSION = MissionPlan(resolve(small()), "sparse", DEADLY)


def flown(mission):
    """Records by run id, and all specs."""
    items = list(fly_mission(mission))
    specs = {spec.run_id: spec for item in items if isinstance(item, Planned) for spec in item.specs}
    return specs, {item.run_id: item for item in items if isinstance(item, CompletedRun)}


def test_a_mission_is_planned_before_it_is_flown_and_in_two_parts():
    items = list(fly_mission(MISSION))
    plan_indices = [index for index, item in enumerate(items) if isinstance(item, Planned)]
    assert plan_indices == [0, 3]
    assert [items[index].last for index in plan_indices] == [False, True]
    assert [spec.setting for spec in items[0].specs] == ["golden", "golden_gaussian"]
    assert {spec.kind for spec in items[3].specs} == {"injected", "null"}
    assert {spec.world for index in plan_indices for spec in items[index].specs} == {("sparse", DEADLY)}
    assert {item.run_id for item in items[4:]} == {spec.run_id for spec in items[3].specs}


def test_it_is_a_function_of_its_plan_alone_and_leaves_nothing_behind():
    _, first = flown(MISSION)
    flown(replace(MISSION, seed=10_003))
    flown(replace(MISSION, environment="dense"))
    for again in (MISSION, replace(MISSION, fast_forward=False), pickle.loads(pickle.dumps(MISSION))):
        assert flown(again)[1] == first


def test_what_is_done_is_not_given_again_but_all_is_planned():
    specs, everything = flown(MISSION)
    done = frozenset(list(everything)[::2])
    again, left = flown(replace(MISSION, done=done))
    assert again == specs
    assert left == {run_id: item for run_id, item in everything.items() if run_id not in done}


@pytest.mark.parametrize("seed", [DEADLY, 10_000])
def test_flown_alone_it_gives_the_same(seed):
    mission = replace(MISSION, seed=seed)
    assert flown(replace(mission, alone=True)) == flown(mission)


@pytest.mark.slow
@pytest.mark.parametrize(("count", "survives"), [(ATTEMPTS_ALONE - 1, True), *at_night((1000, False))])
def test_a_run_in_a_child_has_three_attempts(tmp_path, monkeypatch, count, survives):
    _, sound = flown(MISSION)
    monkeypatch.setattr(TROUBLE, "dies", deaths(tmp_path / "deaths", count))
    specs, completed = flown(replace(MISSION, alone=True))
    if survives:
        assert completed == sound and not any((tmp_path / "deaths").iterdir())
    else:
        dead = {run_id for run_id, item in completed.items() if item.record.end is End.DUE}
        assert dead == {run_id for run_id, spec in specs.items() if spec.fault is not None}
        assert len(list((tmp_path / "deaths").iterdir())) == 1000 - ATTEMPTS_ALONE * len(dead)


def test_the_wall_clock_is_no_effect_of_a_fault(monkeypatch):
    ends = iter(
        [ChildEnd("crash", detail="SIGSEGV"), ChildEnd("hang", detail=WALL_CLOCK), ChildEnd("crash", detail="SIGSEGV")]
    )
    really = alone._run_in_child
    monkeypatch.setattr(alone, "_run_in_child", lambda *arguments: next(ends, None) or really(*arguments))
    _, completed = flown(replace(MISSION, alone=True))
    [lost] = [item for item in completed.values() if item.record.end is not End.FLOWN]
    assert (lost.record.end, lost.record.error) == (End.UNKNOWN, "took too long")


def test_golden_runs_without_a_detector_say_how_often_consumers_acted():
    specs, completed = flown(MISSION)
    acted = {specs[run_id].setting: item.record.acted_on for run_id, item in completed.items()}
    expected = {name: len(times) for name, times in fakes.golden_profile(DEADLY).times_us.items()}
    assert acted.pop("golden") == expected
    assert not any(acted.values())


def test_injected_runs_prove_what_was_injected():
    specs, completed = flown(MISSION)
    for run_id, spec in specs.items():
        if spec.kind == "golden":
            assert completed[run_id].record.injections == ()
            continue
        [injection] = completed[run_id].record.injections
        assert injection.activated == spec.fault.has_site
        assert injection.site.split("[")[0] == spec.fault.site.split("[")[0]


def test_a_golden_run_that_raises_is_unknown_and_its_faults_have_no_site(monkeypatch):
    def fly(setup, detector, fault):
        if fault is None and detector is None:
            raise ZeroDivisionError("a mistake of ours")
        return really(setup, detector, fault)

    really = fakes.fly
    monkeypatch.setattr(fakes, "fly", fly)
    specs, completed = flown(MISSION)
    ends = {spec.setting: completed[run_id].record.end for run_id, spec in specs.items() if spec.kind == "golden"}
    assert ends == {"golden": End.UNKNOWN, "golden_gaussian": End.FLOWN}
    assert not any(spec.fault.has_site for spec in specs.values() if spec.fault is not None)
    assert len(completed) == len(specs)


@pytest.mark.parametrize(("golden", "due"), [(lambda arm: None, True), (lambda arm: os._exit(9), False)])
def test_a_process_that_dies_without_its_fault_too_is_a_failure_of_the_machine(golden, due):
    """What `fly_mission` does with a mission whose worker died; memory is not exhausted in a test."""
    runs = alone.fly_alone([injected(1, None).spec], lambda spec: os._exit(9), golden)
    if due:
        assert [flown.record.end for flown in runs] == [End.DUE]
    else:
        with pytest.raises(MachineError, match="the process died, and that of its golden run, too"):
            next(runs)
