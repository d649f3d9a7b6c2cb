"""What fast-forwarding answers is what a flight from take-off is, bit for bit."""

from dataclasses import asdict, replace
from functools import cache

import pytest

from mavfi.campaign.config import load_campaign
from mavfi.campaign.mission import MissionPlan, fly_mission
from mavfi.campaign.plan import CompletedRun
from mavfi.campaign.resolve import resolve as resolve_campaign
from mavfi.extras.bench.sealed import Checksum, Duplicate, Oracle
from mavfi.faults.fault import NO_SITE, FaultSite
from mavfi.flight.decide import INLINE, RecoveryPolicy
from mavfi.flight.fast_forward import FastForward
from mavfi.flight.fly import fly
from mavfi.flight.host import ArmSetup
from mavfi.flight.known_flights import FlownArm
from mavfi.flight.mission_flights import LocalHost
from mavfi.levels.level import parse
from mavfi.levels.state.fault import StateFault
from mavfi.record import End, canonical, plain
from tests.core.flights.missions import Scripted, fault, golden, mission
from tests.core.flights.test_checkpoints import Nervous, content, detector_of
from tests.night import at_night

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
    StateFault(FaultSite("planning.path", "x", 0), NO_SITE, 60),
    replace(fault("control.command", "vx", 4.0, 61), lasts_s=1.0),
    replace(fault("planning.waypoint", "y", 5.0, 52), times=2),
    replace(fault("control.command", "vy", 6.0, 50), lasts_s=float("inf"), share=0.3, seed=7),
    fault("perception.point_cloud", "length_x", 4.0, 31),
    fault("perception.map_update", "length_log_odds", 6.5, 31),
    parse("state:control.command.vx:set=nan:every=3@4..5").resolve(0, "published"),
    parse("message:control.command:delay=0.3:times=30@4").resolve(0),
    parse("state:planning.trajectory.y[3]:bias=2@trajectory_seq>1").resolve(0, "published"),
    parse("message:perception.point_cloud:duplicate@3").resolve(0),
    parse("state:planning.waypoint.vy:freeze:times=3@5").resolve(0, "published"),
    parse("message:sensor.depth:reorder=2@5").resolve(0),
    parse("message:planning.path:drop@0").resolve(0),
]
"""They break the mission, or are masked at once or late; at the very start, without a site, never striking, null; they
last; they lose a message; or they are other operations on values and messages."""

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


def every_fault(autopilot, arm, forward, detector, faults=FAULTS):
    """Runs of which its answer is another one."""
    other = []
    for number, injected in enumerate([None, *faults]):
        mine = forward.fly(injected, FlownArm(arm, detector))
        truth = fly(mission(autopilot), injected, detector, profile=injected is None)
        if content(mine.log) != content(truth.log):
            other.append(number)
    return other


@pytest.mark.parametrize(
    ("autopilot", "arm"),
    [
        ("published", "gaussian"),
        *at_night(*(("published", arm) for arm in ("", "autoencoder", "nervous"))),
        *at_night(*(("hardened", arm) for arm in ARMS["hardened"])),
    ],
)
def test_fast_forwarded_flights_are_the_flights(autopilot, arm):
    forward = FastForward(mission(autopilot))
    faults = FAULTS if autopilot == "published" else FAULTS[::2]
    assert every_fault(autopilot, arm, forward, ARMS[autopilot][arm](), faults) == []
    if arm != "nervous":  # which alarms all the time
        assert forward.share.simulated < 0.85 * forward.share.ticks
        assert forward.share.converged > 0


@pytest.mark.slow
@pytest.mark.long
def test_detectors_share_what_was_flown_in_any_order():
    forward, arms = FastForward(mission()), {name: make() for name, make in ARMS["published"].items()}
    for injected in (FAULTS[3], None, FAULTS[6]):
        for arm in reversed(arms):
            detector = arms[arm]
            truth = content(fly(mission(), injected, ARMS["published"][arm]()).log)
            assert content(forward.fly(injected, FlownArm(arm, detector)).log) == truth
    assert forward.share.replayed > 0


def test_the_golden_flight_leaves_its_profile_and_can_be_asked_for_again():
    forward = FastForward(mission())
    for _ in range(2):
        flight = forward.fly()
        assert plain(asdict(flight.profile)) == plain(asdict(golden().profile))
        assert content(flight.log) == content(golden().log)
        assert forward.fly(FAULTS[0]).profile is None


@pytest.mark.slow
def test_the_octree_is_fast_forwarded_too():
    forward, scenario = FastForward(mission(map="octree")), mission(map="octree")
    for injected in (None, FAULTS[7], FAULTS[4]):
        assert content(forward.fly(injected).log) == content(fly(scenario, injected).log)
    assert forward.share.simulated < forward.share.ticks


def test_a_masked_fault_costs_a_second_of_flight():
    forward = FastForward(mission())
    forward.fly()
    before = forward.share.simulated
    forward.fly(fault("sensor.odometry", "wx", 7.0, 62))  # nobody reads it
    assert forward.share.simulated - before <= 2 * forward.pitch


def test_a_detector_of_which_no_copy_can_be_made_flies_the_long_way():
    class Streaming(Scripted):
        def start(self):
            super().start()
            self.stream = (number for number in range(3))

    with pytest.raises(TypeError):
        FastForward(mission()).fly(None, FlownArm("streaming", Streaming()))
    flights = LocalHost().mission({"streaming": ArmSetup(mission(), Streaming)})
    assert content(flights.golden("streaming").log) == content(golden().log)


@pytest.mark.slow
@pytest.mark.parametrize(
    "recovery", [RecoveryPolicy("observer"), RecoveryPolicy(same_twice="limit")], ids=["observer", "limit"]
)
@pytest.mark.long
def test_other_recovery_without_restarts_is_fast_forwarded_too(recovery):
    forward = FastForward(mission())
    for make in (Nervous, ARMS["published"]["gaussian"]):
        for injected in (None, FAULTS[0], FAULTS[3], FAULTS[6], FAULTS[8]):
            detector = make()
            mine = forward.fly(injected, FlownArm(make.__name__, detector, recovery))
            assert content(mine.log) == content(fly(mission(), injected, make(), recovery=recovery).log)
    assert forward.share.simulated < forward.share.ticks


def escalating(**more):
    return RecoveryPolicy(grain="message", same_twice="escalate", answer_s=0.6, **more)


ESTIMATED = [FAULTS[number] for number in (0, 6, 16)]
ESTIMATED += [fault("sensor.imu", "fx", 4.0, 62), fault("sensor.position", "x", 5.0, 60)]
ESTIMATED += [fault("perception.odometry", "x", 4.0, 62)]


def under_an_estimator(arm, faults=(None, *ESTIMATED)):
    """The fast-forward of a mission with estimated state, and runs of which its answer is another one."""
    scenario, other = mission(localization="estimator"), []
    forward = FastForward(scenario)
    for injected in faults:
        mine = forward.fly(injected, FlownArm(arm, ARMS["published"][arm]()))
        if content(mine.log) != content(fly(scenario, injected, ARMS["published"][arm]()).log):
            other.append(injected)
    return forward, other


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("arm", ["", "nervous"])
def test_the_estimated_state_is_fast_forwarded_too(arm):
    forward, other = under_an_estimator(arm)
    assert other == []
    if arm != "nervous":
        assert forward.share.simulated < 0.9 * forward.share.ticks


def test_flights_with_jitter_of_latencies_are_fast_forwarded_too():
    scenario = mission(latency_jitter=1.0)
    forward = FastForward(scenario)
    for arm, make in (("", lambda: None), ("nervous", Nervous)):
        for injected in (None, FAULTS[0], FAULTS[3], FAULTS[8]):
            direct = fly(scenario, injected, make())
            assert content(forward.fly(injected, FlownArm(arm, make())).log) == content(direct.log)
    assert forward.share.simulated < forward.share.ticks


TAKING_PART = {
    "checksum": (lambda: Checksum(), RecoveryPolicy(grain="message")),
    "oracle": (lambda: Oracle(), RecoveryPolicy(grain="kernel")),
    "silent": (lambda: Scripted(), RecoveryPolicy(grain="message")),
    "duplicate": (lambda: Duplicate(), INLINE),
    "recommended": (lambda: detector_of("recommended", "paper", mission()), escalating()),
    "restarts": (lambda: Scripted("perception.map_update", n=25, stage="perception", times=3, hard=True), escalating()),
    "hold": (lambda: Scripted("control.command", n=300, times=200, hard=True), escalating(degraded="hold")),
}
"""Detectors that act on flights without an alarm, or answer one depending on earlier events."""


def under(name, forward, faults):
    """Runs with a detector that takes part of which the answer is another one, and the logs from take-off."""
    make, recovery = TAKING_PART[name]
    detector, other, logs = make(), [], []
    for number, injected in enumerate(faults):
        mine = forward.fly(injected, FlownArm(name, detector, recovery))
        logs.append(fly(mission(), injected, make(), recovery=recovery).log)
        if content(mine.log) != content(logs[-1]):
            other.append(number)
    return other, logs


STRUCK = [None, *(FAULTS[number] for number in (0, 3, 8, 9, 13, 20, 16, 17))]


@pytest.mark.parametrize(
    "name", ["recommended", "restarts", *at_night("checksum", "oracle", "silent", "duplicate", "hold")]
)
def test_detectors_that_take_part_are_fast_forwarded_too(name):
    forward = FastForward(mission())
    faults = STRUCK[:3] if name == "hold" else STRUCK  # which holds its position to the time limit
    other, logs = under(name, forward, faults)
    assert other == []
    assert forward.share.simulated < forward.share.ticks
    if name in ("checksum", "oracle", "recommended"):  # a message that is sent again leaves no trace
        assert forward.share.converged > 0
    if name in ("restarts", "hold"):
        kinds = {alarm.action for log in logs for alarm in log.alarms}
        assert kinds >= {"restarts": {"resend", "recompute", "restart"}, "hold": {"hold"}}[name]


@cache
def table1(autopilot):
    """The table's campaign on a profile."""
    return load_campaign("table1").model_copy(update={"autopilot": autopilot, "first_seed": 10_100})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("environment", "autopilot"),
    [
        ("dense", "published"),
        *at_night(("factory", "hardened"), *((name, "published") for name in ("factory", "farm", "sparse"))),
    ],
)
def test_a_mission_of_the_table_leaves_the_same_records(environment, autopilot):
    """All arms, all stages, both strata and a null fault; `benchmarks/fast_forward.py` compares hundreds of runs."""
    campaign = resolve_campaign(table1(autopilot)).with_models()
    plan = MissionPlan(campaign, environment, campaign.config.first_seed)
    flown = [
        {
            item.run_id: item.record
            for item in fly_mission(replace(plan, fast_forward=fast))
            if isinstance(item, CompletedRun)
        }
        for fast in (False, True)
    ]
    records = [{run: canonical(record.to_json()) for run, record in runs.items()} for runs in flown]
    assert records[0] == records[1] and len(records[0]) >= 12
    assert all(record.end is End.FLOWN for record in flown[0].values())
