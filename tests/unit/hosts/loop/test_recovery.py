"""What is done about an alarm: one table for every host and both couplings."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mavfi.detectors import Alarm, Detector
from mavfi.detectors.detector import checked_alarm
from mavfi.detectors.replicas import replicated
from mavfi.detectors.rules import NO_COLLISION
from mavfi.errors import BadInputError
from mavfi.flight_record import LIMITED, SILENCED
from mavfi.hosts.local import fly
from mavfi.hosts.loop.compose import resolve
from mavfi.hosts.loop.decision import Action, decide, record_of
from mavfi.hosts.loop.policy import INLINE, Recovery
from mavfi.hosts.loop.recovery import MOST_ALARMS, MOST_UNCHANGED, Watch
from mavfi.hosts.watching import with_keys_of
from mavfi.kernels.recovery.limits import ALARMS_WITHIN_US, MOST_RESTARTS, RESTART_US
from mavfi.kernels.recovery.response import DEGRADE, RECOMPUTED, RESENT, RESTART
from mavfi.mission import MissionSpec, MissionStatus
from mavfi.pipeline.functions import PLAIN
from mavfi.states import PPC_STAGES, STAGE_KERNELS, STATES, Stage, new_state

OBSERVER = Recovery("observer")
PERCEPTION = STAGE_KERNELS[Stage.PERCEPTION]
CASES = [
    (
        Alarm("d", "control"), "control.command",
        Action("recompute", Stage.CONTROL, "pid", ("pid",), "control.command", True),
    ),
    (
        Alarm("d", "planning"), "planning.waypoint",
        Action("recompute", Stage.PLANNING, "waypoint", ("waypoint",), "planning.waypoint", True),
    ),
    (
        Alarm("d", "perception"), "perception.map_update",
        Action("recompute", Stage.PERCEPTION, PERCEPTION[0], PERCEPTION, "perception.map_update", True),
    ),
    (
        Alarm("d", "perception"), "perception.odometry",
        Action("recompute", Stage.PERCEPTION, "state_estimation", ("state_estimation",), "perception.odometry", True),
    ),
    (Alarm("d", "control"), "planning.waypoint", Action("recompute", Stage.CONTROL, "pid", ("pid",))),
    (Alarm("d", "planning"), "control.command", Action("recompute", Stage.PLANNING)),
    (Alarm("d", "perception"), "sensor.odometry", Action("recompute", Stage.PERCEPTION)),
    (
        Alarm("d", "control", abandon_waypoint=True), "control.command",
        Action("abandon", Stage.CONTROL, "waypoint", (), "planning.waypoint"),
    ),
    (
        Alarm("d", "control", stop=True), "planning.waypoint",
        Action("stop", Stage.CONTROL, "waypoint", (), "planning.waypoint", True),
    ),
]  # fmt: skip


@pytest.mark.parametrize(("alarm", "state", "expected"), CASES)
def test_the_answer_to_an_alarm(alarm, state, expected):
    assert decide(alarm, STATES[state], INLINE) == expected


@pytest.mark.parametrize(("alarm", "state", "expected"), CASES)
def test_an_observer_asks_for_the_same_and_holds_nothing_back(alarm, state, expected):
    answer = decide(alarm, STATES[state], OBSERVER)
    assert not answer.withholds
    assert (answer.kind, answer.kernel, answer.restores, answer.awaited) == (
        expected.kind, expected.kernel, expected.restores, expected.awaited,
    )  # fmt: skip


@pytest.mark.parametrize("stage", ["sensor", "steering", ""])
def test_a_stage_that_cannot_be_run_again_is_refused(stage):
    with pytest.raises(
        BadInputError, match=r"^detector \S+:_Reckless: alarm 'd': stage .* perception, planning, control"
    ):
        checked_alarm(_Reckless(), Alarm("d", stage))


class _Reckless(Detector):
    """A detector that gives no `Alarm`."""

    states = None

    def check(self, state, time_us):
        return True

    def accept(self, state, time_us):
        pass


def test_what_is_no_alarm_is_refused_with_the_detectors_class():
    message = r"^detector \S+:_Reckless: check returned True; allowed: an Alarm, or None$"
    with pytest.raises(BadInputError, match=message):
        checked_alarm(_Reckless(), True)
    with pytest.raises(BadInputError, match=message):
        replicated(_Reckless(), 2).check(new_state("control.command"), 0)


@pytest.mark.parametrize("score", ["high", None, (1.0,)])
def test_a_score_that_is_no_number_is_refused_before_it_reaches_a_record(score):
    with pytest.raises(BadInputError, match=r":_Reckless: alarm 'd': score .*: allowed: a number, in units of the"):
        checked_alarm(_Reckless(), Alarm("d", "control", score=score))


@pytest.mark.parametrize("score", [2, np.float32(2.0), np.int64(2)])
def test_numbers_of_all_kinds_are_scores(score):
    found = checked_alarm(_Reckless(), Alarm("d", "control", score=score))
    assert type(found.score) is float and found == Alarm("d", "control", score=2.0)


def test_what_passes_is_recorded_as_accepted():
    alarm = Alarm("d", "planning", score=2.0, fields=("control.command.vx",))
    record = record_of(alarm, decide(alarm, STATES["control.command"], INLINE), "control.command", 1_500_000)
    assert (record.time_s, record.action, record.outcome, record.fields) == (
        1.5, "recompute", "accepted", ("control.command.vx",),
    )  # fmt: skip


# ---- a rule that is broken twice, and an alarm that nobody answers ------------------------------------------------
STATUS, PATH = "perception.collision_status", "planning.path"
ESCALATES = Recovery(grain="kernel", same_twice="escalate", answer_s=0.6)


def test_only_the_kernel_that_wrote_the_value_is_stepped_again():
    answer = decide(Alarm("d", "perception"), STATES[STATUS], Recovery(grain="kernel"))
    assert answer == Action(
        "recompute", Stage.PERCEPTION, "collision_check", ("collision_check",), STATUS, True, alone=True
    )


def test_a_detector_that_is_right_is_asked_on():
    class EverySecond(Always):
        def check(self, state, now):
            return super().check(state, now) if now % 2 else None

    flight = Flight()
    values = [(now, status(now)) for now in range(6 * MOST_ALARMS + 1)]
    shown(EverySecond(hard=True), ESCALATES, values, flight)
    assert len(flight.outcomes) == 3 * MOST_ALARMS and flight.events == []
    assert set(flight.outcomes) == {("recompute", "repaired")}


def test_a_message_that_is_wrong_twice_is_computed_again():
    recovery = Recovery(grain="message", same_twice="escalate")
    alarm = Alarm("d", "perception", hard=True)
    assert decide(alarm, STATES[STATUS], recovery) == Action("resend", Stage.PERCEPTION, awaited=STATUS, withholds=True)
    assert decide(alarm, STATES[STATUS], recovery, after=RESENT) == Action(
        "recompute", Stage.PERCEPTION, "collision_check", ("collision_check",), STATUS, True, alone=True
    )


def test_an_alarm_about_a_recomputation_restarts_the_writer():
    answer = decide(Alarm("d", "perception", hard=True), STATES[STATUS], ESCALATES, after=RECOMPUTED)
    assert answer == Action("restart", Stage.PERCEPTION, "collision_check", withholds=True)


class Flight:
    """As much of a loop as a watch needs."""

    def __init__(self, alarm="one_shot"):
        self.scenario = SimpleNamespace(autopilot=SimpleNamespace(alarm=alarm, replanning="on_alarm"), v_max=3.0)
        self.functions = PLAIN
        self.awaited, self.requests, self.busy, self.down = {}, {}, {}, set()
        self.events = []
        self.record = SimpleNamespace(alarms=[], note=lambda now, kind, data: self.events.append((now, kind)))
        self.steps, self.restarted = [], []
        self.deliver = self.at = self.charge = lambda *arguments: None

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


class Never(Always):
    def check(self, state, now):
        return None


def shown(detector, recovery, values, flight, restarts_left=MOST_RESTARTS):
    """Which of the values pass."""
    watch = Watch(flight, detector, recovery, flight.restart)
    watch.memory.restarts_left = restarts_left
    return [watch(state, now) is not None for now, state in values]


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


@pytest.mark.parametrize("pause", [1, ALARMS_WITHIN_US // (MOST_ALARMS - 1) + 1])
def test_a_detector_that_alarms_without_end_is_not_asked_any_more(pause):
    flight, detector = Flight(), Always(hard=True)
    values = [(place * pause, status(5)) for place in range(2 * MOST_ALARMS)]
    shown(detector, ESCALATES, values, flight)
    endless = pause == 1
    assert [kind for _, kind in flight.events] == ([SILENCED] if endless else [])
    assert (len(flight.outcomes) == MOST_ALARMS) == endless
    assert detector.accepted[-1] == values[-1][0], "it continues to take note"


def test_the_limit_is_that_of_the_key():
    described = MissionSpec.model_fields["same_twice"].description
    assert f"at most {MOST_UNCHANGED} times in {ALARMS_WITHIN_US // 1_000_000} s" in described


@pytest.mark.parametrize("hard", [True, False])
def test_recomputations_that_change_nothing_are_limited(hard):
    flight, second, limit = Flight(), 1_000_000, Recovery(same_twice="limit")
    burst = [(place, status(5)) for place in range(4 * MOST_UNCHANGED)]
    later = [(ALARMS_WITHIN_US + now, state) for now, state in burst]
    before, after = [(2 * second, status(5)), (9 * second, status(5))], [(21 * second, status(5))]
    passed = shown(Always(hard), limit, [*burst, *before, *later, *after], flight)
    answered = [False, True] * MOST_UNCHANGED + [True] * 2 * MOST_UNCHANGED
    assert passed == [*answered, True, True, *answered, False]
    assert flight.events[0] == (2 * (MOST_UNCHANGED - 1), LIMITED) and {kind for _, kind in flight.events} == {LIMITED}
    assert set(flight.outcomes[:-1]) == {("recompute", "accepted")}


def test_after_a_skipped_way_point_there_is_no_response_for_a_minute():
    class Skipping(Always):
        def check(self, state, now):
            return replace(super().check(state, now), stage="control", abandon_waypoint=True)

    flight, second = Flight(), 1_000_000
    instants = (1, 2, 30 * second, 50 * second, 59 * second, 61 * second, 62 * second, 122 * second)
    shown(Skipping(hard=False), Recovery(same_twice="limit"), [(now, status(5)) for now in instants], flight)
    assert [round(alarm.time_s) for alarm in flight.record.alarms] == [0, 61, 122]
    assert {alarm.action for alarm in flight.record.alarms} == {"abandon"}
    assert flight.events == [(1, LIMITED), (61 * second, LIMITED), (122 * second, LIMITED)]


@pytest.mark.parametrize(("coupling", "count"), [("inline", 2 * MOST_UNCHANGED), ("observer", MOST_UNCHANGED)])
def test_recomputations_that_repair_are_limited_only_where_the_next_value_differs_in_any_case(coupling, count):
    class EverySecond(Always):
        def check(self, state, now):
            return super().check(state, now) if state.header["future_collision_seq"][0] == 5 else None

    flight = Flight()
    values = [(now, status(5 if now % 2 else 6)) for now in range(1, 4 * MOST_UNCHANGED)]
    shown(EverySecond(hard=False), Recovery(coupling, same_twice="limit"), values, flight)
    assert len(flight.outcomes) == count


@pytest.mark.parametrize(
    ("hard", "recovery", "left"),
    [(False, ESCALATES, 5), (True, Recovery(grain="kernel"), 5), (True, ESCALATES, 0)],
)
def test_otherwise_the_same_value_twice_is_accepted(hard, recovery, left):
    flight, detector = Flight(), Always(hard)
    assert shown(detector, recovery, [(1, status(5)), (2, status(5))], flight, left) == [False, True]
    assert flight.outcomes == [("recompute", "accepted")] and flight.restarted == [] and detector.accepted == [2]


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


def free(number, time=NO_COLLISION, blocked=math.inf):
    """Status of a free trajectory."""
    state = status(number)
    state.header["time_to_collision"], state.header["distance_to_blocked"] = time, blocked
    return state


def waypoint(index=3):
    state = new_state("planning.waypoint")
    state.header["index"] = index
    return state


@pytest.mark.parametrize(
    ("withdrawal", "ends"),
    [
        (free(3), True),
        (free(3, time=1.5), False),  # the flag is lost, the time is not
        (free(3, blocked=4.0), False),
        (free(2), False),
        (status(3, flag=True), False),
    ],
)
def test_an_alarm_that_is_withdrawn_needs_no_answer(withdrawal, ends):
    late = [(700_000, free(3)), (900_000, status(3, flag=True)), (1_400_000, status(3, flag=True))]
    for alarm, index, restarted in (("repeated", 3, not ends), ("one_shot", 3, True), ("repeated", -1, True)):
        flight = Flight(alarm)
        values = [(0, waypoint(index)), (1, status(3, flag=True)), (200_000, withdrawal)]
        values += late if ends else [(700_000, status(3, flag=True))]
        shown(Never(hard=True), ESCALATES, values, flight)
        assert [kernel for kernel, *_ in flight.restarted] == ["planner"] * restarted


def test_an_alarm_that_returns_starts_a_new_wait():
    flight = Flight("repeated")
    values = [
        (0, waypoint()), (1, status(3, flag=True)), (200_000, status(4, flag=True)), (400_000, free(4)),
        (800_000, status(5, flag=True)), (1_300_000, status(5, flag=True)), (1_500_000, status(5, flag=True)),
    ]  # fmt: skip
    shown(Never(hard=True), ESCALATES, values, flight)
    assert flight.restarted == [("planner", 1_500_000, RESTART_US)]


def test_a_flight_has_a_few_restarts_at_most():
    flight = Flight()
    values = [(now, status(5)) for now in range(4 * MOST_RESTARTS)]
    assert any(shown(Always(hard=True), ESCALATES, values, flight)), "in the end the value passes"
    assert len(flight.restarted) == MOST_RESTARTS


def test_without_a_time_limit_nobody_waits():
    flight = Flight()
    shown(Never(hard=True), Recovery(), [(0, status(3, flag=True)), (10**9, status(3))], flight)
    assert flight.restarted == []


def test_a_mission_says_how_alarms_are_answered():
    spec = MissionSpec(coupling="observer", grain="kernel", same_twice="escalate", answer_s=0.6)
    assert Recovery.of(spec) == Recovery("observer", "kernel", "escalate", 0.6)
    assert Recovery.of(MissionSpec()) == INLINE and not INLINE.restarts


# ---- what restarts do not help ------------------------------------------------------------------------------------
COMMAND = "control.command"
HOVERS = Recovery(grain="kernel", same_twice="escalate", answer_s=0.6, degraded="hover")
AFTERWARDS = [(10**9, new_state(COMMAND)), (10**9 + 1, status(9)), (10**9 + 2, new_state("planning.waypoint"))]
"""The first of them is withheld in the degraded mode, the others pass."""


def test_without_a_restart_left_a_rule_broken_twice_ends_in_hover():
    flight = Flight()
    assert shown(Always(hard=True), HOVERS, [(1, status(5)), (2, status(5)), *AFTERWARDS], flight, 0) == [
        False, True, False, True, True,
    ]  # fmt: skip
    assert flight.outcomes == [("recompute", "rejected"), ("hover", "accepted")] and flight.restarted == []


def test_the_command_that_starts_it_is_withheld():
    flight = Flight()
    values = [(1, new_state(COMMAND)), (2, new_state(COMMAND)), (3, new_state(COMMAND))]
    assert shown(Always(hard=True), HOVERS, values, flight, 0) == [False] * 3
    assert flight.outcomes[-1] == ("hover", "accepted") and len(flight.outcomes) == 2


@pytest.mark.parametrize(
    ("pitch_us", "hard", "degraded", "expected"),
    [(200_000, True, "hover", True), (300_000, True, "hover", False), (200_000, False, "hover", False),
     (200_000, True, "none", False)],
)  # fmt: skip
def test_hard_alarms_that_persist_end_in_hover(pitch_us, hard, degraded, expected):
    flight, recovery = Flight(), Recovery(grain="kernel", degraded=degraded)
    # every second value is the result of a recomputation, which is not judged
    values = [(number * pitch_us, status(5)) for number in range(24)]
    shown(Always(hard), recovery, values, flight)
    assert ("hover", "accepted") in flight.outcomes or not expected
    assert sum(action == "hover" for action, _ in flight.outcomes) == expected


def test_persisting_takes_two_seconds():
    flight, recovery = Flight(), Recovery(grain="kernel", degraded="hover")
    shown(Always(hard=True), recovery, [(number * 100_000, status(5)) for number in range(60)], flight)
    hovered = next(alarm for alarm in flight.record.alarms if alarm.action == "hover")
    assert 2.0 < hovered.time_s <= 2.2


def test_an_alarm_without_an_answer_ends_in_hover_when_no_restart_is_left():
    flight = Flight()
    values = [(1_000_000, status(3, flag=True)), (1_700_000, status(3)), *AFTERWARDS]
    assert shown(Never(hard=True), HOVERS, values, flight, 0) == [True, True, False, True, True]
    assert flight.outcomes == [("hover", "accepted")] and flight.restarted == []


@pytest.mark.parametrize("mode", ["hold", "back"])
def test_other_modes_replace_commands_by_their_own(mode):
    flight, recovery = Flight(), replace(HOVERS, degraded=mode)
    flown = [odometry(0.4 * number) for number in range(11)]
    watch = Watch(flight, Always(hard=True), recovery, flight.restart)
    watch.memory.restarts_left = 0
    for state in flown:
        watch._setpoints.note(watch.memory.trail, state, flown=True)
    assert [watch(state, 20 + now) is None for now, state in ((0, status(5)), (1, status(5)))] == [True, False]
    assert flight.outcomes[-1] == (mode, "accepted") and watch.memory.degraded
    command = watch(new_state(COMMAND), 30)
    vx = float(command.header["vx"][0])
    assert vx == (0.0 if mode == "hold" else -1.5), "of the stored points 0, 1.2, 2.4 and 3.6 m the last is reached"
    assert watch(odometry(6.0), 40) is not None and watch(new_state(COMMAND), 50).header["vx"][0] < -1.0
    target = watch.memory.trail.points[-1][0]
    assert target == (4.0 if mode == "hold" else pytest.approx(2.4)), "what is flown now is not the path"


@pytest.mark.parametrize("number", [-(2**31), -1, 0, 6, 2**30])
def test_a_corrupted_number_of_restarts_ends_after_a_few(number):
    flight = Flight()
    values = [(now, status(5)) for now in range(4 * MOST_RESTARTS)]
    shown(Always(hard=True), ESCALATES, values, flight, number)
    assert len(flight.restarted) == (MOST_RESTARTS if number > 0 else 0)


def odometry(x):
    state = new_state("sensor.odometry")
    state.header["x"] = x
    return state


def test_an_observer_cannot_withhold_commands():
    with pytest.raises(BadInputError, match="degraded: hover: withholds commands; allowed: with coupling inline"):
        Recovery("observer", degraded="hover")
    assert Recovery(degraded="hover").remembers and not INLINE.remembers and ESCALATES.remembers


def test_each_restart_of_a_flight_takes_longer():
    flight = Flight()
    shown(Always(hard=True), ESCALATES, [(now, status(5)) for now in range(4 * MOST_RESTARTS)], flight)
    assert [away / RESTART_US for _, _, away in flight.restarted] == [1, 3, 9, 27, 81]
    assert sum(away for _, _, away in flight.restarted) > 1_000_000


# ---- a fault in the selection itself -------------------------------------------------------------------------------
POLICIES = [
    INLINE, OBSERVER, ESCALATES, Recovery(grain="message"), Recovery(grain="kernel", answer_s=0.6),
    Recovery(grain="kernel", same_twice="escalate", degraded="hold"), Recovery(degraded="back"),
]  # fmt: skip
CODES = [-1, *range(9), 2**40]


class Control(Always):
    def check(self, state, now):
        return Alarm("d", "control", hard=self.hard)


@pytest.mark.parametrize("recovery", POLICIES, ids=str)
@pytest.mark.parametrize("code", CODES)
@pytest.mark.parametrize("detector", [Always, Control])
@pytest.mark.parametrize("left", [0, MOST_RESTARTS])
def test_whatever_response_is_selected_it_is_one_of_the_policy_or_none(recovery, code, detector, left):
    flight, asked = Flight(), detector(hard=True)
    flight.functions = replace(PLAIN, respond=lambda *arguments: code)
    watching, value = Watch(flight, asked, recovery, flight.restart), status(0)
    watching.memory.restarts_left = left
    watching.seal(value, 0)
    passed = watching(value, 0)
    kinds = {"recompute", "stop", "abandon", recovery.grain.replace("message", "resend"), recovery.degraded}
    kinds |= {"restart"} if left and recovery.same_twice == "escalate" else set()
    assert {alarm.action for alarm in flight.record.alarms} <= kinds
    assert bool(flight.restarted) == (code == RESTART and "restart" in kinds)
    if not flight.record.alarms:
        assert passed is value and asked.accepted[-1:] == [0], "a value passes whose alarm has no response"


@pytest.mark.parametrize("code", CODES)
@pytest.mark.parametrize("degraded", ["none", "hold"])
def test_a_deadline_restarts_the_planner_or_degrades_whatever_is_selected(code, degraded):
    flight = Flight()
    flight.functions = replace(PLAIN, respond=lambda *arguments: code)
    watching = Watch(flight, Never(hard=True), replace(ESCALATES, degraded=degraded), flight.restart)
    for now in (0, 600_001):
        watching(status(5, flag=True), now)
    expected = ["restart"] if code == RESTART else [degraded] if code == DEGRADE and degraded != "none" else []
    assert [alarm.action for alarm in flight.record.alarms] == expected
    assert [kernel for kernel, *_ in flight.restarted] == (["planner"] if code == RESTART else [])


@pytest.mark.parametrize("code", CODES)
@pytest.mark.parametrize("entry", ["escalate", "series_start", "frequency", "down_time", "left_after"])
@pytest.mark.parametrize("recovery", [*POLICIES, Recovery(same_twice="limit")], ids=str)
def test_whatever_a_limit_evaluates_to_the_response_is_one_of_the_policy_or_none(recovery, entry, code):
    flight, asked = Flight(), Always(hard=True)
    flight.functions = replace(PLAIN, **{entry: lambda *arguments: code})
    watching, values = Watch(flight, asked, recovery, flight.restart), [status(number // 2) for number in range(40)]
    for now, value in enumerate(values):
        watching.seal(value, now)
        watching(value, now)
    kinds = {"recompute", recovery.grain.replace("message", "resend"), recovery.degraded}
    kinds |= {"restart"} if recovery.same_twice == "escalate" else set()
    assert {alarm.action for alarm in flight.record.alarms} <= kinds
    assert all(down >= 0 for *_, down in flight.restarted)


@pytest.mark.parametrize("entry", ["escalate", "respond"])
def test_a_dead_recovery_does_not_respond(entry):
    flight = Flight()
    flight.functions = replace(PLAIN, **{entry: lambda *arguments: 0})
    assert shown(Always(hard=True), HOVERS, [(1, status(5)), (2, status(5))], flight, 0) == [True, True]
    assert flight.outcomes == [] and flight.restarted == []


@pytest.mark.parametrize("code", CODES)
def test_whatever_becomes_of_a_wait_only_one_that_has_begun_is_overdue(code):
    flight = Flight()
    flight.functions = replace(PLAIN, wait_for_path=lambda *arguments: code)
    watching = Watch(flight, Never(hard=True), ESCALATES, flight.restart)
    watching(status(5), 700_000)
    assert flight.restarted == []


class Nervous(Never):
    """Alarms at every twentieth value of the mission computer."""

    states, asked = None, 0

    def start(self): ...

    def check(self, state, now):
        self.asked += state.spec.stage in PPC_STAGES
        alarms = state.spec.stage in PPC_STAGES and self.asked % 20 == 0
        return Alarm("d", state.spec.stage.value, hard=True) if alarms else None


@pytest.mark.slow
@pytest.mark.parametrize("code", CODES)
@pytest.mark.parametrize("name", ["gaussian", "recommended"])
def test_a_flight_ends_whatever_response_is_selected(name, code):
    bare = MissionSpec(environment="sparse", seed=7, start=(2.0, 0.0, 3.0), goal=(9.0, 0.0, 3.0))
    mission = with_keys_of(bare, name)
    faulty, asked = replace(PLAIN, respond=lambda *arguments: code), Nervous(hard=True)
    flown = fly(resolve(mission), None, asked, recovery=Recovery.of(mission), functions=faulty)
    assert isinstance(flown.log.status, MissionStatus) and asked.asked > 100
