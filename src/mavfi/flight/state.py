"""State of a flight in progress: all that its loop changes from one event to the next."""

import heapq
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np

from mavfi.flight.decide import Action, PendingResult
from mavfi.mission import MissionStatus
from mavfi.pipeline.memory import Memory
from mavfi.states import State


class EventKind(IntEnum):
    """What happens at an instant; `Loop` has a handler for each kind."""

    TICK = 0  # a control period begins
    CAPTURE = 1  # the camera takes an image
    SENSE = 2  # the motion sensors are sampled, between two control periods
    STEP_DONE = 3  # the latency of a kernel's step has elapsed
    ARRIVE = 4  # a message arrives that the injector has held back, or sends once more
    RESEND = 5  # a producer retransmits its copy of a value
    REPETITION_DONE = 6  # the latency of a repeated step has elapsed, see `Loop.repeat_step`
    RESTART = 7  # the node of a kernel returns, see `flight.restarts`
    CALL = 8  # a function of an injector or host is called, see `Loop.call_at`


Event = tuple[int, int, EventKind, tuple[Any, ...]]
"""Instant (us), sequence number, kind, and arguments of its handler."""


@dataclass(slots=True, eq=False)
class FlightState(Memory):
    """What a loop changes in a flight, besides plant, kernels, taps and record.

    A checkpoint is a `copy`, and a flight continues from one as it did there.  Two flights continue in the same way
    from states that are the `same`, if their plants and kernels are as well.  Only `Loop` assigns to the fields.

    Attributes:
        reference: Position of the way-point in force (m). Shape (3,).
        now: The current instant (us).
        queue: Events to come, a heap.
        scheduled: Number of events scheduled so far: events of equal time keep the order of their requests.
        busy: Kernels whose latency has not elapsed, each with its pending input.
        down: Kernels whose node is down.
        awaited: Recomputations in progress, by state.
        requests: Recomputations requested for the kernel's next step, by kernel (coupling `observer`).
        command: The command in force: velocity (m/s) and yaw rate (rad/s). Shape (4,).
        is_mapped: Whether the map contains the scan in progress, whose collision check has not ended.
        captured_us: Instant of the last image (us).
        failed_plans: Number of consecutive plans without a path.
        next_fix_us: When the next position fix is due (us).
        estimate: The last estimate published to consumers: position (m) and quaternion. Shape (7,).
        status: The final status; None = the mission continues.
    """

    reference: np.ndarray
    now: int = 0
    queue: list[Event] = field(default_factory=list)
    scheduled: int = 0
    busy: dict[str, State | None] = field(default_factory=dict)
    down: set[str] = field(default_factory=set)
    awaited: dict[str, PendingResult] = field(default_factory=dict)
    requests: dict[str, Action] = field(default_factory=dict)
    command: np.ndarray = field(default_factory=lambda: np.zeros(4))
    is_mapped: bool = False
    captured_us: int = 0
    failed_plans: int = 0
    next_fix_us: int = 0
    estimate: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))
    status: MissionStatus | None = None

    def schedule(self, time_us: int, kind: EventKind, *arguments: Any) -> None:  # noqa: ANN401 (as the handler wants)
        """Add an event to the queue."""
        self.scheduled += 1
        heapq.heappush(self.queue, (time_us, self.scheduled, kind, arguments))

    def normalize(self) -> None:
        """Number the events from 0, so that equivalent queues are the same: only their order matters."""
        ordered = sorted(self.queue, key=lambda event: event[:2])
        self.queue = [(time, number, kind, arguments) for number, (time, _, kind, arguments) in enumerate(ordered)]
        self.scheduled = len(self.queue)
