"""`Recovery`: the policy by which a mission responds to the alarms of its detector."""

from dataclasses import dataclass
from typing import Literal

from mavfi.errors import BadInputError
from mavfi.mission import RECOVERY, MissionSpec


@dataclass(frozen=True, slots=True)
class Recovery:
    """Recovery policy for the alarms of a detector; the attributes are keys of a mission.

    Attributes:
        coupling: Coupling of the detector, see `recovery`.
        grain: Unit of repetition: the `stage` with its latency; only the `kernel` that wrote the value; or its
            `message`, which the producer retransmits from its copy at no modelled cost, also if it cannot be read.
        same_twice: Policy for a recomputation that violates a rule again (`Alarm.hard`): `accept` it, or `escalate` to
            a restart of the node (coupling `inline` only), or `limit` the rate of recomputations that change nothing,
            so that a detector that raises alarms without end cannot delay a flight at each step.
        answer_s: Deadline for the path that answers a collision alarm (s), after which the planner's node is restarted;
            0 = none.
        degraded: Policy when a rule is still violated with no restart left, or when hard alarms persist: `none`
            continues the mission, `hold` gives it up, see `degraded.HoldPosition`.

    Raises:
        BadInputError: A degraded mode with coupling `observer`, which cannot withhold commands.
    """

    coupling: Literal["inline", "observer"] = "inline"
    grain: Literal["stage", "kernel", "message"] = "stage"
    same_twice: Literal["accept", "escalate", "limit"] = "accept"
    answer_s: float = 0.0
    degraded: Literal["none", "hold"] = "none"

    def __post_init__(self) -> None:
        if self.degrades and not self.gates:
            raise BadInputError(f"degraded: {self.degraded}: withholds commands; allowed: with coupling inline")

    @staticmethod
    def of(spec: MissionSpec) -> "Recovery":
        """The recovery policy of a mission."""
        return Recovery(*(getattr(spec, key) for key in RECOVERY))

    @property
    def gates(self) -> bool:
        """Whether the detector is a gate, which can withhold a value."""
        return self.coupling == "inline"

    @property
    def escalates(self) -> bool:
        """Whether a rule violated twice restarts a node; not with an observer, as its values are consumed first."""
        return self.same_twice == "escalate" and self.gates

    @property
    def restarts(self) -> bool:
        """Whether the policy includes node restarts."""
        return self.escalates or self.answer_s > 0

    @property
    def limits(self) -> bool:
        """Whether the rate of recomputations without a change is limited."""
        return self.same_twice == "limit"

    @property
    def confirms(self) -> bool:
        """Whether another value after an alarm confirms it; an observer's next value differs in any case."""
        return not self.limits or self.gates

    @property
    def resends(self) -> bool:
        """Whether the producer's copy is retransmitted."""
        return self.grain == "message"

    @property
    def degrades(self) -> bool:
        """Whether there is a degraded mode."""
        return self.degraded != "none"

    @property
    def remembers(self) -> bool:
        """Whether it depends on more than its own earlier alarms, on which a limit depends, see `decide.History`."""
        return self.restarts or self.degrades


INLINE = Recovery()
"""A gate that repeats the stage and accepts the result, even if it is the same value."""
