"""Scorers of the codes of all fields (`field_codes`), in compiled code."""

from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np

from mavfi.detectors.features import REGIMES
from mavfi.detectors.scoring import Reading, Scorer, Threshold, score_of
from mavfi.detectors.training import Sample
from mavfi.extras.bench.field_codes import COMPILED, FieldCodes
from mavfi.extras.bench.residual_state import REGIME, SLOT, ResidualState
from mavfi.numerics.jit import entry, kernel_jit
from mavfi.states import STATES, State


class Judged(NamedTuple):
    """Score of the publication judged last.

    Attributes:
        distance: See `scoring.Reading`. Shape (n,).
        unit: See `scoring.Reading`. Shape (n,).
        ratios: See `scoring.Threshold`. Shape (n,).
        score: Shape (1,).
    """

    distance: np.ndarray
    unit: np.ndarray
    ratios: np.ndarray
    score: np.ndarray


@kernel_jit
def conclude(first: int, last: int, measured: ResidualState, judged: Judged, limit: np.ndarray) -> float:
    """Score of the distances [first, last), also stored."""
    reading = Reading(judged.distance, judged.unit, first, last, measured.place[REGIME])
    judged.score[0] = score_of(reading, limit, judged.ratios)
    return float(judged.score[0])


class CodeScorer(Scorer):
    """A scorer of the codes of all fields: a publication costs one call for its codes and one for its score.

    Each call commits what the publication before it left, if that was accepted.

    Args:
        field_codes: Computes the codes.
        tables: Further tables and memory of the compiled functions.

    Attributes:
        judge: Compiled: residual state, `Judged`, limits of the threshold, then the tables; returns the score of the
            publication measured last.
        learns: Compiled: adapts to an accepted publication; same arguments as `judge`. None: nothing is learned.
    """

    judge: ClassVar[Callable[..., float]]
    learns: ClassVar[Callable[..., None] | None] = None

    def __init__(self, field_codes: FieldCodes, *tables: Any) -> None:  # noqa: ANN401 - arrays, tuples of them, numbers
        self.field_codes, self.kept = field_codes, {"known": field_codes.measured.known}
        self.fields, self.stages, self.states = field_codes.fields, field_codes.stages, field_codes.states
        self._distance, self._unit = np.zeros(len(self.fields)), np.ones(len(self.fields))
        self._tables: tuple[Any, ...] = tables
        self._slots = field_codes.slots

    def span(self, slot: int) -> tuple[int, int]:
        """First and one past the last index of the distances that a publication of a state updates."""
        return self.field_codes.range_of(slot)

    def use(self, threshold: Threshold) -> None:
        """Set the threshold; called before the first flight."""
        super().use(threshold)
        judged = Judged(self._distance, self._unit, threshold.ratios, np.zeros(1))
        self._judged_last = judged
        self._tables = (self.field_codes.measured, judged, threshold.limit, *self._tables)
        self.instrument({})

    @property
    def compiled(self) -> Mapping[str, Callable[..., Any]]:
        """See `Scorer.compiled`."""
        return {**COMPILED, "judge": self.judge}

    def instrument(self, made: Mapping[str, Callable[..., Any]]) -> None:
        """See `Scorer.instrument`."""
        self.field_codes.instrument(made)
        self._judge: Callable[..., float] = entry(made.get("judge", self.judge), *self._tables)

    def __getstate__(self) -> dict[str, Any]:
        """Pickle without machine code and addresses, which are valid in one process only."""
        return {name: value for name, value in self.__dict__.items() if name != "_judge"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Inverse of `__getstate__`."""
        self.__dict__.update(state)
        self.instrument({})

    def start(self) -> None:
        """Reset the memory at the start of a flight."""
        super().start()
        self.field_codes.forget()
        self.candidate = None

    def score(self, state: State) -> float | None:
        """Score of a publication."""
        slot = self._slots.get(state.spec.name)
        if slot is None:
            return None
        self.candidate = state
        self.field_codes.read(state, slot)
        return float(self._judge(*self._tables))

    def judged(self) -> Reading:
        """Reading of the publication scored last."""
        judged, place = self._judged_last, self.field_codes.measured.place
        first, last = self.span(int(place[SLOT]))
        return Reading(judged.distance, judged.unit, first, last, int(place[REGIME]))

    def accept(self, state: State) -> None:
        """Record a published value."""
        if state is not self.candidate:
            if state.spec.name not in self._slots:
                self.field_codes.note(state)
                return
            self.score(state)
        self.field_codes.accept()

    def _settle(self) -> None:
        self.field_codes.settle()
        if self.learns is not None:
            self.learns(*self._tables)

    def memory(self) -> tuple[bytes, ...]:
        """Memory between publications."""
        self._settle()
        return super().memory()

    def arrays(self) -> dict[str, np.ndarray]:
        """Memory between publications by name: the arrays themselves, not copies."""
        self._settle()
        self.candidate = None
        return super().arrays()

    def restore(self, memory: tuple[bytes, ...]) -> None:
        """Inverse of `memory`."""
        super().restore(memory)
        self.field_codes.forget()
        self.candidate = None

    def not_finite(self, state: State) -> np.ndarray:
        """Indices of the watched fields of a publication that are not finite."""
        return self.field_codes.not_finite(state)


class StateScorer(CodeScorer):
    """A scorer with one distance per state instead of one per field: its fields are the states.

    Args:
        field_codes: See `CodeScorer`.
        tables: See `CodeScorer`.
    """

    def __init__(self, field_codes: FieldCodes, *tables: Any) -> None:  # noqa: ANN401 - see `CodeScorer`
        super().__init__(field_codes, *tables)
        self.fields = tuple(field_codes.slots)
        self.stages = tuple(STATES[name].stage.value for name in self.fields)
        self._distance, self._unit = np.zeros(len(self.fields)), np.ones(len(self.fields))

    def span(self, slot: int) -> tuple[int, int]:
        """See `CodeScorer.span`."""
        return slot, slot + 1

    def not_finite(self, state: State) -> np.ndarray:
        """The state itself."""
        return np.array([self.field_codes.slots[state.spec.name]])


def state_peaks(scores: np.ndarray, sample: Sample, slots: int) -> tuple[np.ndarray, np.ndarray]:
    """Largest score in training and number of samples, by state and regime. Shapes (slots, regimes).

    Args:
        scores: Score of each publication of a sample, >= 0. Shape (m,).
        sample: The publications.
        slots: Number of states.
    """
    place = sample.slots * REGIMES + sample.regimes
    peaks = np.full(slots * REGIMES, 1e-9)
    np.maximum.at(peaks, place, scores)
    counts = np.bincount(place, minlength=slots * REGIMES)
    return peaks.reshape(slots, REGIMES), counts.reshape(slots, REGIMES)
