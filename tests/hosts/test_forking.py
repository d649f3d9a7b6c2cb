"""What a family answers is what a flight from take-off is, bit for bit."""

from functools import cache

import numpy as np
import pytest

from mavfi.campaign.config import load_campaign
from mavfi.campaign.plan import arms_of, plan_golden, plan_world
from mavfi.campaign.run import campaign_scenarios, model_hashes
from mavfi.campaign.store import canonical
from mavfi.campaign.tools import host_tools
from mavfi.campaign.worker import Task, forget_families, run_task
from mavfi.faults.fault import NO_SITE, Fault, FaultSite
from mavfi.flight_log import Profile
from mavfi.hosts import forking
from mavfi.hosts.forking import Family
from mavfi.hosts.local import fly
from tests.hosts.missions import STACKS, Scripted, fault, golden, mission
from tests.hosts.test_checkpoints import Nervous, content, detector_of

FAULTS = [
    fault("control.command", "vx", 4.0, 62),
    fault("control.command", "vy", 6.0, 3),
    fault("control.tracking", "remaining", 5.0, 50),
    fault("planning.waypoint", "x", 3.0, 55),
    fault("planning.waypoint", "y", 6.0, 62),
    fault("planning.trajectory", "z", 0.3, 53, element=7),
    fault("perception.map_update", "log_odds", 5.0, 31, element=500),
    fault("perception.point_cloud", "x", 4.0, 20, element=900),
    fault("perception.collision_status", "time_to_collision", 1.0, 61),
    fault("perception.collision_status", "future_collision_seq", 1.0, 30),
    fault("sensor.depth", "range", 0.0, 29, element=3),
    fault("sensor.odometry", "wx", 7.0, 62),
    fault("planning.path", "x", 0.0, 52, element=1),
    fault("control.command", "vx", 1e4, 62),
    fault("control.command", "vx", 8.0),
    Fault("state", FaultSite("planning.path", "x", 0), NO_SITE, 60),
]
"""They break the mission, or are masked at once or late; at the very start, without a site, never striking, null."""

ARMS = {
    "published": {
        "": lambda: None,
        "gaussian": lambda: detector_of("gaussian", "paper", mission()),
        "autoencoder": lambda: detector_of("autoencoder", "paper", mission()),
        "nervous": Nervous,
    },
    "hardened": {
        "": lambda: None,
        "gaussian": lambda: detector_of("gaussian", "tuned", mission("hardened")),
        "silent": Scripted,
    },
}


def every_fault(stack, arm, family, detector, faults=FAULTS):
    """Runs of which the family's answer is another one."""
    other = []
    for number, struck in enumerate([None, *faults]):
        mine = family.fly(struck, detector, arm)
        truth = fly(mission(stack), struck, detector, profile=struck is None)
        if content(mine.log) != content(truth.log):
            other.append(number)
    return other


IN_THE_FAST_SUITE = [("published", "gaussian"), ("hardened", "")]


@pytest.mark.parametrize(
    ("stack", "arm"),
    [
        pytest.param(stack, arm, marks=() if (stack, arm) in IN_THE_FAST_SUITE else pytest.mark.slow)
        for stack in STACKS
        for arm in ARMS[stack]
    ],
)
def test_forked_flights_are_the_flights(stack, arm):
    family = Family(mission(stack))
    assert every_fault(stack, arm, family, ARMS[stack][arm]()) == []
    assert family.share.flights == 1 + len(FAULTS)
    if arm != "nervous":  # which alarms all the time
        assert family.share.flown < 0.75 * family.share.ticks
        assert family.share.joined > 0


@pytest.mark.slow
def test_detectors_share_what_was_flown_in_any_order():
    family, arms = Family(mission()), {name: make() for name, make in ARMS["published"].items()}
    for struck in (FAULTS[3], None, FAULTS[6]):
        for arm in reversed(arms):
            detector = arms[arm]
            truth = content(fly(mission(), struck, ARMS["published"][arm]()).log)
            assert content(family.fly(struck, detector, arm).log) == truth
    assert family.share.shown > 0


def test_the_golden_flight_leaves_its_profile_and_can_be_asked_for_again():
    family = Family(mission())
    for _ in range(2):
        flight = family.fly()
        assert flight.profile.to_bytes() == golden().profile.to_bytes()
        assert content(flight.log) == content(golden().log)
        assert family.fly(FAULTS[0]).profile is None


@pytest.mark.slow
def test_the_octree_is_forked_too():
    family, scenario = Family(mission(map="octree")), mission(map="octree")
    for struck in (None, FAULTS[7], FAULTS[4]):
        assert content(family.fly(struck).log) == content(fly(scenario, struck).log)
    assert family.share.flown < family.share.ticks


def test_a_masked_fault_costs_a_second_of_flight():
    family = Family(mission())
    family.fly()
    before = family.share.flown
    family.fly(fault("sensor.odometry", "wx", 7.0, 62))  # nobody reads it
    assert family.share.flown - before <= 2 * family.pitch


@pytest.mark.slow
def test_to_stop_too_early_is_noticed(monkeypatch):
    monkeypatch.setattr(forking, "is_at", lambda *_: True)
    assert every_fault("published", "", Family(mission()), None, FAULTS[:4]) != []


@pytest.mark.slow
def test_to_begin_at_the_wrong_place_is_noticed(monkeypatch):
    monkeypatch.setattr(forking.Track, "before", lambda track, time_us: sorted(track.checkpoints)[-2])
    assert every_fault("published", "", Family(mission()), None, FAULTS[:4]) != []


def test_a_detector_of_which_no_copy_can_be_made_flies_the_long_way(monkeypatch):
    class Streaming(Scripted):
        def start(self):
            super().start()
            self.stream = (number for number in range(3))

    with pytest.raises(TypeError):
        Family(mission()).fly(None, Streaming(), "streaming")
    campaign = load_campaign("smoke")
    tools = host_tools()
    monkeypatch.setattr("mavfi.campaign.worker.detector_of", lambda task: Streaming())
    spec = plan_golden(campaign, dict.fromkeys(campaign.environments, "key"), [*arms_of(campaign, {})][-1:])[0]
    task = Task(spec, mission(), tools)
    long, forked = run_task(task), run_task(Task(spec, mission(), tools, forking=True))
    assert spec.detector and forked.record["end"] == "flown"
    assert canonical(forked.record) == canonical(long.record)


@cache
def table1(stack):
    """The table's campaign, its tools, scenarios and arms."""
    campaign = load_campaign("table1").model_copy(update={"stack": stack, "first_seed": 10_100})
    tools = host_tools()
    scenarios = campaign_scenarios(campaign, tools)
    return campaign, tools, scenarios, arms_of(campaign, model_hashes(campaign, scenarios, None, tools))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("environment", "stack"),
    [("dense", "published"), ("factory", "hardened")]
    + [pytest.param(name, "published", marks=pytest.mark.long) for name in ("factory", "farm", "sparse")],
)
def test_a_mission_of_the_table_leaves_the_same_records(environment, stack):
    """All arms, all stages, both strata and a null fault; `benchmarks/fast_forward.py` compares hundreds of runs."""
    campaign, tools, scenarios, arms = table1(stack)
    world = environment, campaign.first_seed
    keys = {name: scenario.key() for name, scenario in scenarios.items()}
    scenario = scenarios[environment].model_copy(update={"seed": campaign.first_seed})

    def both(spec):
        results = [run_task(Task(spec, scenario, tools, forking=forking)) for forking in (False, True)]
        assert canonical(results[0].record) == canonical(results[1].record), spec.run_id
        assert results[0].profile == results[1].profile
        return results[0]

    specs = [s for s in plan_golden(campaign, keys, arms) if (s.environment, s.seed) == world]
    golden_runs = [both(spec) for spec in specs]
    injected = plan_world(campaign, keys, arms, world, Profile.from_bytes(golden_runs[0].profile))
    assert len(injected) >= 9
    for spec in injected.values():
        both(spec)
    forget_families()


def test_counts_are_whole_numbers():
    counts = Family(mission()).golden().end.counts
    assert all(isinstance(count, (int, np.integer)) for count in counts)
