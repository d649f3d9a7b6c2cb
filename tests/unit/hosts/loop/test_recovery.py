"""What is done about an alarm: one table for every host and both couplings."""

import pytest

from mavfi.detectors import Alarm
from mavfi.errors import BadInputError
from mavfi.hosts.loop.recovery import INLINE, Action, Recovery, decide, record_of
from mavfi.states import STAGE_KERNELS, STATES, Stage

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
    with pytest.raises(BadInputError, match="allowed: perception, planning, control"):
        decide(Alarm("d", stage), STATES["control.command"], INLINE)


def test_what_passes_is_recorded_as_accepted():
    alarm = Alarm("d", "planning", score=2.0, fields=("control.command.vx",))
    record = record_of(alarm, decide(alarm, STATES["control.command"], INLINE), "control.command", 1_500_000)
    assert (record.time_s, record.action, record.outcome, record.fields) == (
        1.5, "recompute", "accepted", ("control.command.vx",),
    )  # fmt: skip
