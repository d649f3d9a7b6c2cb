"""One of the five rules of docs/engineers.md, alone: what each is worth without the others."""

from dataclasses import replace
from typing import Any

from mavfi.detectors.acceptance import PLAIN, RULES, AcceptanceTest, Functions
from mavfi.detectors.detector import Alarm
from mavfi.detectors.limits import MissionLimits
from mavfi.errors import BadInputError
from mavfi.states import STATES, State

COUNTERS, EPOCHS, DYNAMICS, COPIES, NODES = range(1, 6)
"""Numbers of the rules; the last is a restart policy of nodes, with no check of its own."""
_OF_FIELD = {
    "perception.collision_status.future_collision_seq": COUNTERS,
    "perception.collision_status.collision": COUNTERS,
    "perception.collision_status.trajectory_seq": EPOCHS,
    "planning.path.future_collision_seq": EPOCHS,
    "planning.path.junction": EPOCHS,
    "planning.trajectory.trajectory_seq": EPOCHS,
    "planning.trajectory.future_collision_seq": EPOCHS,
    "planning.waypoint.trajectory_seq": EPOCHS,
    "planning.waypoint.future_collision_seq": EPOCHS,
    "planning.waypoint.index": EPOCHS,
}
_OF_STATE = {"planning.waypoint": COPIES}


def rule_of(field: str) -> int:
    """Number of the rule that a field ("<stage>.<state>.<field>") violates."""
    return _OF_FIELD.get(field) or _OF_STATE.get(field.rpartition(".")[0], DYNAMICS)


def fields_of(rule: int) -> list[str]:
    """Checked fields whose violation is one of the rule with this number."""
    every = (f"{name}.{field.name}" for name in RULES for field in STATES[name].fields)
    return [field for field in every if rule_of(field) == rule]


class SingleRule(AcceptanceTest):
    """The acceptance test, with the alarms of one rule only.

    It finds the first field of a publication that violates any rule, and remembers all publications, as the whole test
    does; a publication passes if that field belongs to another rule.  Its attribute `source` is that of the whole test,
    whose functions and memory it has: the name of these targets of faults.  Its alarms have its own name.

    Args:
        limits: Limits of the mission.
        functions: Compiled code.
        rule: Number of the rule; 5 never raises an alarm.

    Raises:
        BadInputError: There is no such rule.
    """

    def __init__(self, limits: MissionLimits, functions: Functions = PLAIN, rule: int = COUNTERS) -> None:
        if not COUNTERS <= rule <= NODES:
            raise BadInputError(f"rule: {rule}: not known; allowed: {COUNTERS} to {NODES}")
        self.rule = rule
        super().__init__(limits, functions)

    def check(self, state: State, time_us: int) -> Alarm | None:
        """See `Detector.check`; the alarm, of source `rule_1` to `rule_4`, names the field that violates the rule."""
        alarm = super().check(state, time_us)
        if alarm is None or rule_of(alarm.fields[0]) != self.rule:
            return None
        return replace(alarm, source=f"rule_{self.rule}")

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle without machine code, which is valid in one process only."""
        return SingleRule, (self.limits, PLAIN, self.rule), self.memory()
