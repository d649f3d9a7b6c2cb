"""Detectors that watch a stack: trained on its runs without a fault, they raise alarms about what it publishes.

They are observers: what they see is what was recorded, and no message is held back.
"""

import math
from collections import Counter
from collections.abc import Sequence
from itertools import islice
from typing import Any, NamedTuple

from mavfi.extras.ros.ros2.stack.outputs import leaves
from mavfi.extras.shared import foreign
from mavfi.extras.shared.foreign import SMALLEST_SAMPLE, Monitor, NamedNumbers
from mavfi.record import AlarmRecord

_MAX_NUMBERS = 64
"""Largest number of watched numbers of a message."""
_MAX_ALARMS = 100
"""Alarms of a run that are recorded."""
_NONE = "none"


class Publication(NamedTuple):
    """A recorded message.

    Attributes:
        topic: Its topic.
        data: Its compared fields, as plain data.
        time_s: Since the start of the run (s); if inputs wait for outputs, the number of the message of its topic.
        wall_s: Instant of its arrival (s since 1970).
    """

    topic: str
    data: Any
    time_s: float
    wall_s: float = 0.0

    @property
    def numbers(self) -> NamedNumbers:
        """Its numbers."""
        numbers = (
            (name, float(value))
            for name, value in leaves(self.data)
            if isinstance(value, int | float) and not isinstance(value, bool)
        )
        return NamedNumbers(self.topic, round(1e6 * self.time_s), dict(islice(numbers, _MAX_NUMBERS)))


def train(kind: str, profile: str, runs: Sequence[Sequence[Publication]]) -> Monitor:
    """A monitor trained on runs without a fault; `BadInputError` if it is no detector of numbers, or there are none."""
    recordings = [[publication.numbers for publication in run] for run in runs]
    # Runs of a deterministic stack are all equal: what is learned does not depend on how often one is repeated.
    counts = Counter(publication.topic for publication in runs[0])
    copies = math.ceil(SMALLEST_SAMPLE / (min(counts.values()) * len(runs)))
    return foreign.train(kind, profile, recordings * copies)


def alarms_of(monitor: Monitor, run: Sequence[Publication]) -> tuple[AlarmRecord, ...]:
    """The alarms that a monitor raises in a run."""
    monitor.start()
    alarms = []
    for publication in run:
        alarm = monitor.judge(publication.numbers)
        if alarm is not None:
            alarms.append(
                AlarmRecord(
                    publication.time_s, alarm.source, publication.topic, _NONE, alarm.score, alarm.fields, _NONE, _NONE
                )
            )
    return tuple(alarms[:_MAX_ALARMS])
