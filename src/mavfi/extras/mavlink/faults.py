"""Faults in MAVLink frames: `MESSAGE.FIELD:CHANGE` in a number, `MESSAGE:CHANGE` in whole messages.

    SET_POSITION_TARGET_LOCAL_NED.vx:bit=31@n=10     HEARTBEAT:drop@10..20     ATTITUDE_QUATERNION.q1:set=nan@10

Names are those of MAVLink's definitions, elements of arrays have an index, `controls[0]`; a change is described in
`mavfi.faults.changes`.  Times are wall-clock, from the start of the link.

Receivers notice no loss that a fault has made: the sequence numbers of what follows a lost or repeated frame are
counted on without a gap.  A signed frame stays as it is, as its signature would not fit.
"""

import heapq
import random
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mavfi.errors import BadInputError, not_known
from mavfi.extras.shared.mavlink_frames import MavlinkFrame, numbers_of
from mavfi.extras.shared.message_definition import Leaf
from mavfi.faults.changes import Change, ChangeInjector, MessageInjector, parse_text
from mavfi.faults.operations import MESSAGE_OPERATIONS, check_number_operation
from mavfi.record import Injection


class MavlinkFault:
    """A fault in the messages of one type; a bit that its text does not give is drawn from the seed.

    Attributes:
        text: As the user wrote it.
        kind: The type of the messages, of the dialect.
        numbers: Places of the numbers in their payload, by name.
        field: Name of the changed number; "" = whole messages.
        change: What is done, and when.
        seed: Draws the messages of a `share`.
        passed: Number of messages of this type so far.
        changed: Number of those that were changed.
        refusals: Number of those that could not be changed, by reason.

    Raises:
        BadInputError: The text is not understood, or names no message or number of the dialect.
    """

    def __init__(self, text: str, dialect: Any, seed: int = 0) -> None:
        self.text = text
        self.seed = seed
        self.passed = 0
        self.changed = 0
        self.refusals: Counter[str] = Counter()

        # The site: a message, and a number in it.
        site, _, change_text = text.partition(":")
        name, _, self.field = site.partition(".")
        kinds = {kind.msgname: kind for kind in dialect.mavlink_map.values()}
        try:
            if name not in kinds:
                raise BadInputError(f"message {not_known(name, list(kinds))}")
            self.kind = kinds[name]
            self.numbers = numbers_of(self.kind)
            self.change = self._suitable(parse_text(change_text))
        except BadInputError as error:
            raise BadInputError(f"--fault: {text!r}: {error}") from None

    def _suitable(self, change: Change) -> Change:
        """The change, if the messages allow it, with a bit if it flips one."""
        operation = change.operation
        when = change.when
        name = self.kind.msgname
        fields = [self.field]
        if when.condition is not None:
            fields.append(when.condition.field)
        for field in filter(None, fields):
            if field not in self.numbers:
                raise BadInputError(f"number of {name} {not_known(field, list(self.numbers))}")
        if when.sim_time:
            raise BadInputError("sim=: a link has no simulated time; allowed: seconds, n=100, or a condition")
        if not self.field and operation.name not in MESSAGE_OPERATIONS:
            raise BadInputError(f"{operation}: changes a number; allowed: {name}.NUMBER:{operation}")
        if self.field and operation.name != "freeze":
            leaf = self.numbers[self.field]
            if operation.name == "flip" and operation.bit is None:
                operation = replace(operation, bit=random.Random(self.seed).randrange(leaf.bits))
            check_number_operation(operation, leaf.kind)
        return change._replace(operation=operation)

    def refusal(self, frame: MavlinkFrame) -> str:
        """Why the number cannot be changed in a frame; "" = it can."""
        leaf = self.numbers[self.field]
        if frame.is_signed:
            return "the frame is signed: its receiver would refuse it with another content"
        if leaf.offset + leaf.bits // 8 > len(frame.payload):
            return f"a frame of MAVLink 1 has no {self.field}"
        return ""


class PayloadNumber:
    """A number in the payload of a message: what a change reads and writes."""

    def __init__(self, payload: bytearray, leaf: Leaf) -> None:
        self._payload = payload
        self._leaf = leaf

    def read(self) -> np.ndarray:
        """The number. Shape (1,)."""
        return np.frombuffer(self._payload, self._leaf.kind, 1, self._leaf.offset).copy()

    def write(self, word: np.ndarray) -> None:
        """Replace it. Shape (1,)."""
        self._payload[self._leaf.offset : self._leaf.offset + word.nbytes] = word.tobytes()


class FaultyStream:
    """The frames that pass in one direction, with faults.

    Args:
        faults: Each sees what those before it have left.
        report: Takes the record of each change.

    Attributes:
        frames: Number of frames that came.
    """

    def __init__(self, faults: Sequence[MavlinkFault], report: Callable[[Injection], None]) -> None:
        self.frames = 0
        self._report = report
        self._armed: list[tuple[MavlinkFault, ChangeInjector | MessageInjector[MavlinkFrame]]] = []
        for fault in faults:
            if fault.field:
                self._armed.append((fault, ChangeInjector.of(fault.change, fault.seed)))
            else:
                self._armed.append((fault, MessageInjector(fault.change, self._send, fault.seed)))
        # Frames that are sent later: instant, order, frame.
        self._queue: list[tuple[int, int, MavlinkFrame]] = []
        self._queued = 0
        # Of each source: how many frames more than it sent have left, and the last sequence number.
        self._surplus: Counter[bytes] = Counter()
        self._last: dict[bytes, int] = {}

    @property
    def next_us(self) -> float:
        """When the next late frame is to be sent (us); infinity = there is none."""
        if self._queue:
            return self._queue[0][0]
        return float("inf")

    def passed(self, frame: MavlinkFrame, time_us: int) -> Iterator[bytes]:
        """What is sent now that a frame has come."""
        self.frames += 1
        arriving: MavlinkFrame | None = frame
        for fault, injector in self._armed:
            if arriving is not None and arriving.kind is fault.kind:
                fault.passed += 1
                arriving = self._changed(fault, injector, arriving, time_us)
        if arriving is None:
            self._surplus[frame.source] -= 1
        else:
            yield self._numbered(arriving, frame.sequence + self._surplus[frame.source])
        yield from self.late(time_us)

    def late(self, time_us: int) -> Iterator[bytes]:
        """Late and repeated frames whose time has come."""
        while self.next_us <= time_us:
            frame = heapq.heappop(self._queue)[2]
            self._surplus[frame.source] += 1
            yield self._numbered(frame, self._last.get(frame.source, frame.sequence - 1) + 1)

    def _send(self, frame: MavlinkFrame, time_us: int) -> None:
        """Send a frame at an instant (us)."""
        self._queued += 1
        heapq.heappush(self._queue, (time_us, self._queued, frame))

    def _numbered(self, frame: MavlinkFrame, sequence: int) -> bytes:
        """The bytes of a frame with a sequence number; the same bytes, if it has that number."""
        self._last[frame.source] = sequence
        if frame.sequence != sequence % 256:
            frame = frame.rebuilt(sequence=sequence)
        return frame.data

    def _changed(
        self,
        fault: MavlinkFault,
        injector: "ChangeInjector | MessageInjector[MavlinkFrame]",
        frame: MavlinkFrame,
        time_us: int,
    ) -> MavlinkFrame | None:
        """The frame that arrives in the place of one of the fault's messages; None = none does."""
        payload = bytearray(frame.payload)

        def read(field: str) -> float:
            leaf = fault.numbers[field]
            if leaf.offset + leaf.bits // 8 > len(payload):
                return float("nan")
            return float(leaf.value(payload))

        if not injector.due(time_us, read):
            return frame
        before = after = None
        arriving: MavlinkFrame | None
        if isinstance(injector, MessageInjector):
            arriving = injector.change(frame, time_us)
            is_changed = True
        else:
            refusal = fault.refusal(frame)
            if refusal:
                fault.refusals[refusal] += 1
                injector.take_back()
                return frame
            before, after = injector.change(PayloadNumber(payload, fault.numbers[fault.field]))
            arriving = frame.rebuilt(sequence=frame.sequence, payload=bytes(payload))
            is_changed = bytes(payload) != frame.payload

        # A number that already had the value that is set is reported, and not counted.
        fault.changed += is_changed
        operation = fault.change.operation
        details = {"operation": str(operation), "message": fault.passed}
        site = fault.text.partition(":")[0]
        self._report(
            Injection("message", site, 1e-6 * time_us, operation.bit, before, after, is_changed, details=details)
        )
        return arriving
