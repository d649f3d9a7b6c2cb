"""What is done about an alarm: one table for every host and both couplings."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mavfi.detectors import Alarm, Detector
from mavfi.detectors.detector import checked_alarm
from mavfi.errors import BadInputError
from mavfi.flight.decide import (
    ALARMS_WITHIN_US,
    INLINE,
    MAX_ALARMS,
    MAX_RESTARTS,
    RESTART_US,
    RecoveryPolicy,
)
from mavfi.flight.recovery import DetectorTap
from mavfi.flight.state import FlightState
from mavfi.mission import MissionSpec
from mavfi.record import SILENCED
from mavfi.states import PPC_STAGES, new_state


class _Reckless(Detector):
    """A detector that gives no `Alarm`."""

    states = None

    def check(self, state, time_us):
        return True

    def accept(self, state, time_us):
        pass


@pytest.mark.parametrize("score", ["high", None, (1.0,)])
def test_a_score_that_is_no_number_is_refused_before_it_reaches_a_record(score):
    with pytest.raises(BadInputError, match=r":_Reckless: alarm 'd': score .*: allowed: a number, in units of the"):
        checked_alarm(_Reckless(), Alarm("d", "control", score=score))


# ---- a rule that is broken twice, and an alarm that nobody answers ------------------------------------------------
STATUS, PATH = "perception.collision_status", "planning.path"
ESCALATES = RecoveryPolicy(grain="kernel", same_twice="escalate", answer_s=0.6)


class Flight:
    """As much of a loop as a tap needs."""

    def __init__(self, alarm="one_shot"):
        self.scenario = SimpleNamespace(autopilot=SimpleNamespace(alarm=alarm, replanning="on_alarm"), v_max=3.0)
        self.state = FlightState(np.zeros(3))
        self.events = []
        self.record = SimpleNamespace(alarms=[], note=lambda now, kind, data: self.events.append((now, kind)))
        self.steps, self.restarted = [], []
        self.deliver = self.charge = lambda *arguments: None

    def recompute(self, action, now):
        self.steps.append((action.kernel, now))

    def restart(self, kernel, now, after_us):
        self.restarted.append((kernel, now, after_us))

    @property
    def outcomes(self):
        return [(alarm.action, alarm.outcome) for alarm in self.record.alarms]


class Always(Detector):
    """Alarms at every value."""

    def __init__(self, hard):
        self.hard, self.accepted = hard, []

    def check(self, state, now):
        return Alarm("d", state.spec.stage.value, hard=self.hard)

    def accept(self, state, now):
        self.accepted.append(now)


class OfKernels(Always):
    """Alarms at every value that a kernel has written."""

    def check(self, state, now):
        return super().check(state, now) if state.spec.stage in PPC_STAGES else None


class Never(Always):
    def check(self, state, now):
        return None


def shown(detector, recovery, values, flight, restarts_left=MAX_RESTARTS):
    """Which of the values pass."""
    tap = DetectorTap(flight, detector, recovery, flight.restart)
    tap.memory.restarts_left = restarts_left
    return [tap(state, now) is not None for now, state in values]


def status(number, flag=False):
    state = new_state(STATUS)
    state.header["future_collision_seq"], state.header["collision"] = number, flag
    return state


def path(number):
    state = new_state(PATH, 2)
    state.header["future_collision_seq"] = number
    return state


def test_a_rule_that_is_broken_twice_restarts_the_node():
    flight, detector = Flight(), Always(hard=True)
    assert shown(detector, ESCALATES, [(1, status(5)), (2, status(5))], flight) == [False, False]
    assert flight.steps == [("collision_check", 1)]
    assert flight.restarted == [("collision_check", 2, RESTART_US)]
    assert flight.outcomes == [("recompute", "rejected"), ("restart", "restarted")]
    assert detector.accepted == [], "references are values that were published"


def test_an_observer_restarts_no_node_for_it():
    """Consumers have received the first value, so what follows may violate rules without corrupted memory."""
    flight, detector = Flight(), Always(hard=True)
    late = replace(ESCALATES, coupling="observer")
    assert shown(detector, late, [(1, status(5)), (2, status(5))], flight) == [True, True]
    assert flight.restarted == [] and flight.outcomes == [("recompute", "accepted")]
    assert late.restarts and not replace(late, answer_s=0.0).restarts


@pytest.mark.parametrize("pause", [1, ALARMS_WITHIN_US // (MAX_ALARMS - 1) + 1])
def test_a_detector_that_alarms_without_end_is_not_asked_any_more(pause):
    flight, detector = Flight(), Always(hard=True)
    values = [(number * pause, status(5)) for number in range(2 * MAX_ALARMS)]
    shown(detector, ESCALATES, values, flight)
    endless = pause == 1
    assert [kind for _, kind in flight.events] == ([SILENCED] if endless else [])
    assert (len(flight.outcomes) == MAX_ALARMS) == endless
    assert detector.accepted[-1] == values[-1][0], "it continues to take note"


@pytest.mark.parametrize(
    ("answer", "after", "restarted"),
    [(3, 0.7, False), (4, 0.7, False), (2, 0.7, True), (2, 0.5, False), (None, 0.7, True)],
)
def test_an_alarm_that_no_path_answers_in_time_restarts_the_planner(answer, after, restarted):
    flight, seconds = Flight(), 1_000_000
    values = [(0, status(2)), (seconds, status(3, flag=True))]
    values += [] if answer is None else [(round(1.2 * seconds), path(answer))]
    late = round((1 + after) * seconds)
    values.append((late, status(3)))
    assert all(shown(Never(hard=True), ESCALATES, values, flight))
    assert flight.restarted == ([("planner", late, RESTART_US)] if restarted else [])
    assert [alarm.source for alarm in flight.record.alarms] == ["deadline"] * restarted


def test_a_mission_says_how_alarms_are_answered():
    spec = MissionSpec(coupling="observer", grain="kernel", same_twice="escalate", answer_s=0.6)
    assert RecoveryPolicy.of(spec) == RecoveryPolicy("observer", "kernel", "escalate", 0.6)
    assert RecoveryPolicy.of(MissionSpec()) == INLINE and not INLINE.restarts


# ---- what restarts do not help ------------------------------------------------------------------------------------
COMMAND = "control.command"
HOLDS = RecoveryPolicy(grain="kernel", same_twice="escalate", answer_s=0.6, degraded="hold")
AFTERWARDS = [(10**9, new_state(COMMAND)), (10**9 + 1, status(9)), (10**9 + 2, new_state("planning.waypoint"))]
"""The first of them is withheld in the degraded mode, the others pass."""


def test_without_a_restart_left_a_rule_broken_twice_ends_in_degraded_mode():
    flight = Flight()
    assert shown(Always(hard=True), HOLDS, [(1, status(5)), (2, status(5)), *AFTERWARDS], flight, 0) == [
        False,
        True,
        False,
        True,
        True,
    ]
    assert flight.outcomes == [("recompute", "rejected"), ("hold", "accepted")] and flight.restarted == []


@pytest.mark.parametrize(
    ("pitch_us", "hard", "degraded", "expected"),
    [
        (200_000, True, "hold", True),
        (300_000, True, "hold", False),
        (200_000, False, "hold", False),
        (200_000, True, "none", False),
    ],
)
def test_hard_alarms_that_persist_end_in_degraded_mode(pitch_us, hard, degraded, expected):
    flight, recovery = Flight(), RecoveryPolicy(grain="kernel", degraded=degraded)
    # every second value is the result of a recomputation, which is not judged
    values = [(number * pitch_us, status(5)) for number in range(24)]
    shown(Always(hard), recovery, values, flight)
    assert ("hold", "accepted") in flight.outcomes or not expected
    held = [alarm.time_s for alarm in flight.record.alarms if alarm.action == "hold"]
    assert len(held) == expected and all(2.0 < time_s <= 2.4 for time_s in held)


def test_commands_are_replaced_by_those_that_hold_the_position():
    flight = Flight()
    tap = DetectorTap(flight, OfKernels(hard=True), HOLDS, flight.restart)
    tap.memory.restarts_left = 0
    tap(odometry(4.0), 10)
    assert [tap(state, 20 + now) is None for now, state in ((0, status(5)), (1, status(5)))] == [True, False]
    assert flight.outcomes[-1] == ("hold", "accepted") and tap.memory.degraded
    assert tap(new_state(COMMAND), 30).header["vx"][0] == 0.0
    assert tap(odometry(6.0), 40) is not None
    assert tap(new_state(COMMAND), 50).header["vx"][0] == -1.5, "at most v_max / 2"


def odometry(x):
    state = new_state("sensor.odometry")
    state.header["x"] = x
    return state


def test_an_observer_cannot_withhold_commands():
    with pytest.raises(BadInputError, match="degraded: hold: withholds commands; allowed: with coupling inline"):
        RecoveryPolicy("observer", degraded="hold")
    assert RecoveryPolicy(degraded="hold").remembers and not INLINE.remembers and ESCALATES.remembers


def test_a_flight_has_a_few_restarts_and_each_takes_longer():
    flight = Flight()
    shown(Always(hard=True), ESCALATES, [(now, status(5)) for now in range(4 * MAX_RESTARTS)], flight)
    assert [away / RESTART_US for _, _, away in flight.restarted] == [1, 3, 9, 27, 81]
    assert any(shown(Always(hard=True), ESCALATES, [(1, status(5)), (2, status(5))], Flight(), 0)), "the value passes"
