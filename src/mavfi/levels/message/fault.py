"""The planned change of whole messages, or of a number in them."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from mavfi.errors import BadInputError
from mavfi.faults.changes import Change, When
from mavfi.faults.fault import Fault
from mavfi.faults.operations import MESSAGE_OPERATIONS, VALUE_OPERATIONS, Operation


@dataclass(frozen=True, slots=True)
class MessageFault(Fault):
    """Whole messages, or a number in them: of a state in a flight, a ROS topic, or the calls of a program.

    Attributes:
        topic: Name of the state, topic or call.
        field: Path of a number, e.g. `position[0]`; "" = the whole message.
        bit: 0 = least significant; None = drawn for each injection.
        at: Number of the first message that may be changed, from 1.
        rate: Probability that a message is changed; None = one message, once.
        stratum: Always "": not drawn by stratum.
        weight: Always 1.
        seed: Seed of the choice of messages and bits.
        time_us: Messages before this instant are not changed; `NO_SITE` = the golden run has no such message.
        change: What is done, and to which messages from `time_us` on; stored as text, e.g. "drop:times=3@0"; None =
            `bit` is flipped as `at` and `rate` say.

    Raises:
        BadInputError: A number out of range.
    """

    level: ClassVar[Literal["message"]] = "message"
    later_fields: ClassVar[tuple[str, ...]] = ("time_us", "change")
    topic: str
    field: str = ""
    bit: int | None = None
    at: int = 1
    rate: float | None = None
    stratum: str = ""
    weight: float = 1.0
    seed: int = 0
    time_us: int = 0
    change: Change | None = None

    def __post_init__(self) -> None:
        if self.at < 1:
            raise BadInputError(f"at: {self.at}: allowed: 1 or more")
        if self.rate is not None and not 0.0 < self.rate <= 1.0:
            raise BadInputError(f"rate: {self.rate}: allowed: above 0, to 1")
        if self.change is None:
            return
        operation = self.change.operation
        allowed = MESSAGE_OPERATIONS
        if self.field:
            allowed = VALUE_OPERATIONS
        if operation.name not in allowed:
            raise BadInputError(f"fault in {self.site}: {operation.name}: allowed: {', '.join(allowed)}")
        if self.bit is not None or self.at > 1 or self.rate is not None or self.change.when.start_s > 0.0:
            raise BadInputError(f"fault in {self.site}: bit, at, rate: allowed: those of the change {operation}")

    @property
    def planned(self) -> Change:
        """What is done and when, also of a fault without `change`; a flip without a bit draws one each time."""
        if self.change is not None:
            return self.change
        if self.rate is None:
            return Change(Operation("flip", bit=self.bit), When(first=self.at))
        return Change(Operation("flip", bit=self.bit), When(first=self.at, times=0, share=self.rate))

    @property
    def is_of_flight(self) -> bool:
        """Whether it is in whole messages, as those of flights are."""
        return self.change is not None and not self.field

    @property
    def changed_state(self) -> str:
        """See `Fault.changed_state`."""
        return self.topic

    @property
    def site(self) -> str:
        """Topic and field as text."""
        if self.field:
            return f"{self.topic}.{self.field}"
        return self.topic
