from itertools import pairwise

import numpy as np
import pytest

from mavfi import api
from mavfi.detectors import Alarm, Detector
from mavfi.errors import BadInputError
from mavfi.flight.compose import with_keys_of
from mavfi.flight.decide import MAX_UNCHANGED, RecoveryPolicy
from mavfi.flight.fast_forward import FastForward
from mavfi.flight.fly import fly
from mavfi.flight.known_flights import FlownArm
from mavfi.flight.latencies import stage_latency
from mavfi.mission import MissionSpec, MissionStatus
from mavfi.states import PPC_STAGES, STATES, Stage, floats
from tests.core.flights.missions import (
    FAR_GOAL,
    GOAL,
    Scripted,
    each_autopilot,
    fault,
    golden,
    mission,
)

CASES = [
    ("perception.point_cloud", "x", 5, "perception"),
    ("perception.map_update", "log_odds", 5, "perception"),
    ("perception.collision_status", "time_to_collision", 5, "perception"),
    ("planning.waypoint", "x", 6, "planning"),
    ("control.command", "vx", 200, "control"),
]


def stamped(observed):
    return lambda state, time_us: observed.append((time_us, state.spec.name, state))


@each_autopilot
def test_a_detector_that_never_alarms_leaves_the_golden_digest(autopilot):
    detector = Scripted()
    flight = fly(mission(autopilot), detector=detector)
    assert flight.log.digest() == golden(autopilot).log.digest()
    assert flight.log.alarms == []
    assert len(detector.accepted) == sum(flight.log.meta["publications"].values())


@pytest.mark.slow
@each_autopilot
@pytest.mark.parametrize(("state", "field", "n", "stage"), CASES)
def test_a_false_alarm_is_recomputed_to_the_same_value_and_accepted(state, field, n, stage, autopilot):
    del field
    observed = []
    detector = Scripted(state, n, stage)
    flight = fly(mission(autopilot), detector=detector, recorders=[stamped(observed)])
    (alarm,) = flight.log.alarms
    ((when, rejected),) = detector.alarmed
    platform = mission(autopilot).platform
    assert (alarm.action, alarm.outcome, alarm.state) == ("recompute", "accepted", state)
    assert flight.log.meta["recompute_us"][stage] == stage_latency(platform, Stage(stage))
    assert sum(flight.log.meta["recompute_us"].values()) == stage_latency(platform, Stage(stage))
    times = [time for time, name, _ in observed if name == state]
    assert when not in times  # held: it was not seen when it came
    after = min(time for time in times if time > when)
    shown = next(value for time, name, value in observed if name == state and time == after)
    assert shown.same_bits(rejected)
    assert after >= when + stage_latency(platform, Stage(stage)) - 281_000 * (stage == "perception")
    if stage != "perception":
        assert after == when + stage_latency(platform, Stage(stage))
    assert flight.log.status is MissionStatus.SUCCESS


@pytest.mark.slow
@each_autopilot
@pytest.mark.parametrize(("state", "field", "n", "stage"), [case for case in CASES if not STATES[case[0]].acted_on])
def test_a_fault_that_is_found_is_repaired_by_running_the_stage_again(state, field, n, stage, autopilot):
    clean = Scripted(state, n, stage)
    fly(mission(autopilot), detector=clean)
    ((when, expected),) = clean.alarmed
    bit = 30 if STATES[state].find(field).dtype == "f4" else 61
    observed = []
    detector = Scripted(state, n, stage)
    fault_here = fault(state, field, 1e-6 * when, bit, element=0)
    flight = fly(mission(autopilot), fault_here, detector, recorders=[stamped(observed)])
    ((struck_at, struck),) = detector.alarmed
    assert struck_at == when and not struck.same_bits(expected)
    assert flight.log.alarms[0].outcome == "repaired"
    shown = next(value for time, name, value in observed if name == state and time > when)
    assert shown.same_bits(expected)
    assert flight.log.digest() == fly(mission(autopilot), detector=Scripted(state, n, stage)).log.digest()


def test_a_struck_collision_status_is_repaired():
    at = 1e-6 * golden().profile.times_us["perception.collision_status"][0]
    times = []
    fly(mission(), recorders=[lambda s, t: times.append(t) if s.spec.name == "perception.collision_status" else None])
    n = 1 + times.index(round(1e6 * at))
    struck = fault("perception.collision_status", "time_to_collision", at, 62)
    flight = fly(mission(), struck, Scripted("perception.collision_status", n, "perception"))
    assert flight.log.alarms[0].outcome == "repaired"
    clean = fly(mission(), detector=Scripted("perception.collision_status", n, "perception"))
    assert flight.log.digest() == clean.log.digest()


def test_abandoning_takes_the_next_way_point():
    observed = []
    detector = Scripted("control.command", 300, "control", abandon_waypoint=True)
    flight = fly(mission(), detector=detector, recorders=[stamped(observed)])
    (alarm,) = flight.log.alarms
    assert alarm.action == "abandon" and alarm.outcome == "replaced"
    when = detector.alarmed[0][0]
    indices = [(time, int(v.header["index"][0])) for time, name, v in observed if name == "planning.waypoint"]
    before = [index for time, index in indices if time <= when][-1]
    after_time, after = next((time, index) for time, index in indices if time > when)
    assert after == before + 1
    assert after_time == when + stage_latency(mission().platform, Stage.CONTROL)
    assert flight.log.meta["recompute_us"]["control"] == stage_latency(mission().platform, Stage.CONTROL)


def test_a_command_can_be_withheld_with_its_way_point_and_the_next_one_passes():
    observed = []
    detector = Scripted("control.command", 300, "control", times=2, abandon_waypoint=True, withhold=True)
    flight = fly(mission(), detector=detector, recorders=[stamped(observed)])
    alarms = flight.log.alarms
    ((when, withheld), (again, _)) = detector.alarmed
    assert [(alarm.action, alarm.outcome) for alarm in alarms] == [("abandon", "replaced")] * 2
    assert again - when == 40_000, "the command in between is the answer, and is not checked"
    commands = [time for time, name, _ in observed if name == withheld.spec.name]
    assert when not in commands and when + 20_000 in commands
    assert flight.log.status is MissionStatus.SUCCESS


@each_autopilot
def test_without_a_next_way_point_abandoning_holds(autopilot):
    observed = []
    detector = Scripted("planning.waypoint", 1, "control", abandon_waypoint=True)
    flight = fly(mission(autopilot), detector=detector, recorders=[stamped(observed)])
    assert [(alarm.time_s, alarm.action) for alarm in flight.log.alarms] == [(0.0, "abandon")]
    first = next(v for _, name, v in observed if name == "planning.waypoint")
    assert int(first.header["index"][0]) == -1 and first.same_bits(detector.alarmed[0][1])
    assert flight.log.status is MissionStatus.SUCCESS


@each_autopilot
@pytest.mark.parametrize("state", ["control.command", "planning.waypoint"])
def test_requests_for_the_next_way_point_without_end_keep_no_mission_from_its_goal(state, autopilot):
    detector = Scripted(state, 0, "control", times=10**9, abandon_waypoint=True)
    spec = with_keys_of(MissionSpec(environment="dense", seed=7, autopilot=autopilot), detector)
    log = api.fly(spec, detector=detector).log
    assert log.status is MissionStatus.SUCCESS
    times = [alarm.time_s for alarm in log.alarms]
    assert times and all(later - time > 59.999 for time, later in pairwise(times))


@each_autopilot
def test_stopping_holds_and_plans_again(autopilot):
    observed = []
    detector = Scripted("control.command", 300, "control", stop=True)
    flight = fly(mission(autopilot), detector=detector, recorders=[stamped(observed)])
    assert flight.log.alarms[0].action == "stop"
    when = detector.alarmed[0][0]
    after = next(v for time, name, v in observed if name == "planning.waypoint" and time > when)
    assert int(after.header["index"][0]) == -1
    assert (after.header["vx"][0], after.header["vy"][0]) == (0.0, 0.0)
    assert any(event.kind == "plan" and event.time_us > when for event in flight.log.events)
    assert flight.log.status is MissionStatus.SUCCESS


class Everything(Scripted):
    """Alarms at every publication of some states, for one stage or for that of each."""

    def __init__(self, states, stage=""):
        super().__init__()
        self.states, self.one = states, stage

    def check(self, state, time_us):
        self.state, self.stage = state.spec.name, self.one or state.spec.stage.value
        self.n, self.times, self.seen = 0, 1, -1
        return super().check(state, time_us) if state.spec.name in self.states else None


def test_alarms_at_both_states_of_one_step_make_it_run_again_once():
    flight = fly(mission(), detector=Everything(("control.command", "control.tracking"), "control"))
    commands = flight.log.meta["publications"]["control.command"]
    runs = len(flight.log.alarms) // 2
    assert runs >= commands > 100 and len(flight.log.alarms) == 2 * runs
    assert flight.log.meta["recompute_us"]["control"] == 460 * runs


COMPUTED = [name for name, spec in STATES.items() if spec.stage in PPC_STAGES]


@pytest.mark.slow
@each_autopilot
@pytest.mark.parametrize("grain", ["kernel", "message"])
def test_a_detector_that_always_alarms_keeps_no_mission_from_its_goal_if_kernels_are_repeated(autopilot, grain):
    flight = fly(mission(autopilot), detector=Everything(COMPUTED), recovery=RecoveryPolicy(grain=grain))
    assert flight.log.status is MissionStatus.SUCCESS
    assert len(flight.log.alarms) > 500
    delay = flight.log.column("time")[-1] / golden(autopilot).log.column("time")[-1]
    assert delay < 1.1


class Leap(Detector):
    """Alarms at a command or way-point that no flight has."""

    states = ("control.command", "planning.waypoint")

    def check(self, state, time_us):
        del time_us
        if np.abs(floats(state.header, 3)).max() < 1e3:
            return None
        return Alarm("leap", state.spec.stage)


@pytest.mark.parametrize(
    ("detector_place", "alarmed"),
    [
        ("consumer", ["control.command", "planning.waypoint"]),
        ("published", ["planning.waypoint"]),
        ("producer", []),
    ],
)
def test_a_detector_sees_a_fault_on_the_way_at_the_consumer_only(detector_place, alarmed):
    recovery = RecoveryPolicy.of(MissionSpec(detector_place=detector_place))
    forward = FastForward(mission())
    seen = []
    for arm, detector in (("", None), ("leap", Leap())):  # as in campaigns, in which arms share flights
        for state, field, bit in (("control.command", "vx", 62), ("planning.waypoint", "y", 61)):
            injected = fault(state, field, 4.0, bit)
            log = forward.fly(injected, FlownArm(arm, detector, recovery)).log
            assert log.digest() == fly(mission(), injected, detector, recovery=recovery).log.digest()
            at = pytest.approx(log.injections[0].time_s, abs=1e-6)
            seen += [alarm.state for alarm in log.alarms if alarm.time_s == at]
    assert seen == alarmed


@pytest.mark.slow
@pytest.mark.parametrize("states", [COMPUTED, ["planning.waypoint"], ["control.command"]], ids=len)
@pytest.mark.parametrize("coupling", ["inline", "observer"])
@each_autopilot
def test_a_detector_of_ones_own_that_always_alarms_keeps_no_mission_from_its_goal(autopilot, coupling, states):
    spec = with_keys_of(MissionSpec(coupling=coupling), Everything(states))
    goal = FAR_GOAL if coupling == "inline" else GOAL  # long enough for a second series of alarms
    flight = fly(mission(autopilot, goal), detector=Everything(states), recovery=RecoveryPolicy.of(spec))
    assert flight.log.status is MissionStatus.SUCCESS
    if coupling == "inline":  # the next value after one that was consumed differs
        times = [alarm.time_s for alarm in flight.log.alarms if alarm.outcome == "accepted"]
        assert len(times) > MAX_UNCHANGED
        assert all(later - time > 9.999 for time, later in zip(times, times[MAX_UNCHANGED:], strict=False))


def test_keys_of_a_mission_hold_against_those_of_a_detector_only_if_they_are_set():
    spec = MissionSpec(environment="dense", seed=1, goal=GOAL)
    charged = [
        api.fly(chosen, detector=Scripted("planning.waypoint", 6, "planning")).log.meta["recompute_us"]["planning"]
        for chosen in (spec, spec.model_copy(update={"grain": "stage"}))
    ]
    assert charged == [0, stage_latency(mission().platform, Stage.PLANNING)], "the way-point alone takes no time"


def test_a_sensor_cannot_be_run_again_so_its_value_passes():
    observed = []
    detector = Scripted("sensor.odometry", 50, "planning")
    flight = fly(mission(), detector=detector, recorders=[stamped(observed)])
    when, value = detector.alarmed[0]
    assert flight.log.alarms[0].outcome == "accepted"
    assert any(time == when and name == "sensor.odometry" and state.same_bits(value) for time, name, state in observed)
    assert flight.log.digest() == golden().log.digest()


@pytest.mark.parametrize("stage", ["sensor", "steering", ""])
def test_a_stage_that_cannot_be_run_again_is_refused(stage):
    with pytest.raises(BadInputError, match="allowed: perception, planning, control"):
        fly(mission(), detector=Scripted("control.command", 5, stage))
