"""Detectors that watch a stack: trained on its runs without a fault, they raise alarms about what it publishes.

They are observers: what they see is what was recorded, and no message is held back.
"""

import math
import pickle
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from mavfi.detectors.foreign import SMALLEST_SAMPLE, foreign_spec, foreign_state, learn
from mavfi.errors import BadInputError
from mavfi.extras.ros.ros2.stack.outputs import leaves
from mavfi.record import AlarmRecord
from mavfi.states import State, StateSpec

MOST_FIELDS = 64
"""Largest number of watched numbers of a topic."""
MOST_ALARMS = 100
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


class StackWatcher:
    """A detector of the paper (`gaussian`, `autoencoder`) on the numbers of a stack's topics.

    Args:
        kind: Name of the detector.
        profile: "paper" or "tuned".
        runs: Messages of runs without a fault.

    Raises:
        BadInputError: It is no detector of numbers, or there is nothing to watch.
    """

    def __init__(self, kind: str, profile: str, runs: Sequence[Sequence[Publication]]) -> None:
        self._specs = dict(_specs(runs))
        if not self._specs:
            raise BadInputError(f"detector {kind!r}: no number to watch; allowed: outputs with numbers in each message")
        recordings = [list(self._states(run)) for run in runs]
        # Runs of a deterministic stack are all equal: what is learned does not depend on how often one is repeated.
        smallest = min(sum(state.spec is spec for state in recordings[0]) for spec in self._specs.values())
        copies = math.ceil(SMALLEST_SAMPLE / (smallest * len(recordings)))
        self._trained = pickle.dumps(learn(kind, profile, recordings * copies, self._specs))

    def alarms(self, run: Sequence[Publication]) -> tuple[AlarmRecord, ...]:
        """The alarms that it raises in a run."""
        detector = pickle.loads(self._trained)  # with an empty memory
        alarms = []
        for publication in run:
            state = self._state(publication)
            if state is None:
                continue
            time_us = round(1e6 * publication.time_s)
            alarm = detector.check(state, time_us)
            if alarm is not None:
                alarms.append(
                    AlarmRecord(
                        publication.time_s,
                        alarm.source,
                        publication.topic,
                        _NONE,
                        alarm.score,
                        alarm.fields,
                        _NONE,
                        _NONE,
                    )
                )
            detector.accept(state, time_us)
        return tuple(alarms[:MOST_ALARMS])

    def _states(self, run: Sequence[Publication]) -> Iterator[State]:
        for publication in run:
            state = self._state(publication)
            if state is not None:
                yield state

    def _state(self, publication: Publication) -> State | None:
        """The watched numbers of a message; None if it lacks one."""
        spec = self._specs.get(publication.topic)
        if spec is None:
            return None
        values = dict(leaves(publication.data))
        numbers = [values.get(field.name) for field in spec.header]
        if not all(_is_number(number) for number in numbers):
            return None
        return foreign_state(spec, [float(number) for number in numbers if number is not None])


def _specs(runs: Sequence[Sequence[Publication]]) -> Iterator[tuple[str, StateSpec]]:
    """The numbers that all messages of a topic have, by topic."""
    fields: dict[str, dict[str, None]] = {}
    for run in runs:
        for publication in run:
            names = {name: None for name, value in leaves(publication.data) if _is_number(value)}
            known = fields.setdefault(publication.topic, names)
            fields[publication.topic] = {name: None for name in known if name in names}
    for topic, names in fields.items():
        if names:
            yield topic, foreign_spec(topic, list(names)[:MOST_FIELDS])


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def train(detectors: Mapping[str, Sequence[str]], runs: Sequence[Sequence[Publication]]) -> dict[str, StackWatcher]:
    """Train the detectors of arms, given as name and profile, on the runs without a fault."""
    return {arm: StackWatcher(name, profile, runs) for arm, (name, profile) in detectors.items()}
