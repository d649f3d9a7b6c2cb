"""Codes of the fields of messages of any program, for the detector `limits`: changes of each field, quantized.

Their quanta are learned from normal messages, since units and sizes of the fields are unknown.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mavfi.detectors.preprocess import VehicleQueue
from mavfi.detectors.training import Sample, join
from mavfi.extras.bench import residual_state, residuals
from mavfi.extras.bench.field_codes import FieldCodes
from mavfi.extras.bench.residual_state import REGIME, SLOT, ResidualState
from mavfi.numerics.jit import kernel_jit
from mavfi.states import State, StateSpec, floats

_STEPS = 100.0
"""Largest change in training / quantum."""
_BELOW_CONSTANT = 1e-6
"""Quantum of a field that never changes / its magnitude."""


@kernel_jit
def measure_message(values: np.ndarray, slot: int, measured: ResidualState) -> None:
    """Codes of the changes of a message's values since the last one of its state.

    The memory holds the last values of all fields, then for each state whether there are any.
    """
    residual_state.settle(measured)
    measured.after[:] = measured.known
    first, last = measured.spans[slot]
    seen = len(measured.codes) + slot
    for index in range(first, last):
        measured.values[index] = 0.0
        if measured.known[seen] != 0.0:
            measured.values[index] = values[index - first] - measured.known[index]
        measured.after[index] = values[index - first]
    measured.after[seen] = 1.0
    finite = residuals.quantize(measured.values[first:last], measured.quanta[first:last], measured.codes[first:last])
    measured.status[SLOT] = slot
    if finite:
        measured.status[REGIME] = 0
    else:
        measured.status[REGIME] = -1


class MessageCodes(FieldCodes):
    """Codes of all fields of messages; see `FieldCodes`.

    Args:
        specs: The states by name, whose fields are float64.
        recordings: Normal messages, from which the quanta are learned.
    """

    def __init__(self, specs: Mapping[str, StateSpec], recordings: Sequence[Sequence[State]]) -> None:
        self.slots = {name: slot for slot, name in enumerate(specs)}
        self.fields = tuple(f"{name}.{field.name}" for name, spec in specs.items() for field in spec.header)
        self.stages = tuple(spec.stage.value for spec in specs.values() for _ in spec.header)
        self.states = frozenset(specs)
        ends = np.cumsum([len(spec.header) for spec in specs.values()]).tolist()
        self._ranges = list(zip([0, *ends[:-1]], ends, strict=True))
        self.quanta = np.concatenate([_quanta_of(spec, recordings) for spec in specs.values()])
        size = len(self.fields) + len(specs)
        state = residual_state.initial_state(self.quanta, np.array(self._ranges, np.int64))
        self.measured = state._replace(known=np.zeros(size), after=np.zeros(size))
        self.vehicles = VehicleQueue(self.measured)

    def instrument(self, made: Mapping[str, Any]) -> None:
        """See `FieldCodes`; empty, since faults are injected into its functions in missions only."""

    def read(self, state: State, slot: int) -> None:
        """Compute the codes of a message of the state with this slot, in `measured`."""
        first, last = self._ranges[slot]
        measure_message(floats(state.header, last - first), slot, self.measured)

    def note(self, state: State) -> None:
        """See `FieldCodes`; empty, since codes of messages depend on their own state only."""

    def sample(self, states: Sequence[State]) -> Sample:
        """Sample of a recording, as a detector sees it."""
        self.start()
        vectors = np.zeros((len(states), len(self.fields)), np.int16)
        codes = np.zeros(len(self.fields), np.int16)
        slots = np.array([self.slots[state.spec.name] for state in states], np.int64)
        for row, (state, slot) in enumerate(zip(states, slots.tolist(), strict=True)):
            self.record(state, slot, codes)
            vectors[row] = codes
        self.start()
        first = np.zeros(len(states), np.bool_)
        first[np.unique(slots, return_index=True)[1]] = True
        return Sample(vectors, slots, np.zeros(len(states), np.int64), first)

    def samples(self, recordings: Sequence[Sequence[State]]) -> Sample:
        """Sample of all recordings."""
        return join([self.sample(states) for states in recordings if states])


def _quanta_of(spec: StateSpec, recordings: Sequence[Sequence[State]]) -> np.ndarray:
    """Quantum of each field of a state. Shape (fields,)."""
    width = len(spec.header)
    tables = [
        np.array([floats(state.header, width) for state in states if state.spec is spec]) for states in recordings
    ]
    tables = [table for table in tables if len(table)]
    magnitude = np.abs(np.concatenate(tables)).max(axis=0)
    changes = np.max([np.abs(np.diff(table, axis=0)).max(axis=0, initial=0.0) for table in tables], axis=0)
    quanta: np.ndarray = np.where(changes > 0.0, changes / _STEPS, _BELOW_CONSTANT * np.maximum(magnitude, 1.0))
    return quanta
