"""Scorers of the codes of all fields (`everything`), in compiled code."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, ClassVar, NamedTuple

import numpy as np

from mavfi.detectors import book
from mavfi.detectors.autoencoder import Recent
from mavfi.detectors.book import Book
from mavfi.detectors.everything import COMPILED, Everything
from mavfi.detectors.parts import FREQUENT, Reading, Scorer, Threshold, Verdict, score_of
from mavfi.numerics.jit import entry, is_compiled, kernel_jit
from mavfi.numerics.lent import lent
from mavfi.numerics.stored import Stored, kind_of
from mavfi.states import ODOMETRY, State, new_state

_UNPICKLED = ("_own", "_judge", "_admitted", "at_once")


class Judged(NamedTuple):
    """Score of the publication judged last.

    Attributes:
        distance: See `parts.Reading`. Shape (n,).
        unit: See `parts.Reading`. Shape (n,).
        ratios: See `parts.Verdict`. Shape (n,).
        score: Shape (1,).
    """

    distance: np.ndarray
    unit: np.ndarray
    ratios: np.ndarray
    score: np.ndarray


def kind_with(*tables: Any) -> Any:  # noqa: ANN401 - arrays, tuples of them, numbers
    """`kind_of` a book, scores, the limits of a threshold, and examples of further tables."""
    return kind_of(book.BOOK, Judged(*np.zeros((4, 1))), np.zeros((1, 1)), *tables)


@kernel_jit
def conclude(first: int, last: int, own: Book, judged: Judged, limit: np.ndarray) -> float:
    """Score of the distances [first, last), also stored."""
    reading = Reading(judged.distance, judged.unit, first, last, own.place[book.REGIME])
    judged.score[0] = score_of(reading, limit, judged.ratios)
    return float(judged.score[0])


class CodeScorer(Scorer):
    """A scorer of the codes of all fields: a publication costs one call for its codes and one for its score.

    Each call commits what the publication before it left, if that was accepted.

    Args:
        everything: Computes the codes.
        tables: Further tables and memory of the compiled functions.
        recent: Scores that `admit_at` remembers; the same inputs have the same ones.  None: it remembers none.

    Attributes:
        judge: Compiled: book, `Judged`, limits of the threshold, then the tables; returns the score of the publication
            measured last.
        judge_at: Compiled: the same of the address of these.
        admit_at: Compiled: measures the publication, judges it, and accepts it if there is no alarm; arguments:
            address of these, and of `recent` if given, header of the publication.
        learns: Compiled: adapts to an accepted publication; same arguments as `judge`. None: nothing is learned.
        kind: `kind_with` the tables.
        admission: `kind_with` the tables and `recent`, if given.
    """

    judge: ClassVar[Callable[..., float]]
    judge_at: ClassVar[Callable[..., float]]
    admit_at: ClassVar[Callable[..., bool]]
    learns: ClassVar[Callable[..., None] | None] = None
    kind: ClassVar[Any]
    admission: ClassVar[Any]

    def __init__(self, everything: Everything, *tables: Any, recent: Recent | None = None) -> None:  # noqa: ANN401
        self.everything, self.kept = everything, {"known": everything.book.known}
        self.fields, self.stages, self.states = everything.fields, everything.stages, everything.states
        self._distance, self._unit = np.zeros(len(self.fields)), np.ones(len(self.fields))
        self._tables: tuple[Any, ...] = tables
        self._recent, self._slots = recent, everything.slots

    def span(self, slot: int) -> tuple[int, int]:
        """First and one past the last index of the distances that a publication of a state updates."""
        return self.everything.range_of(slot)

    def use(self, threshold: Threshold) -> None:
        """Set the threshold; called before the first flight."""
        super().use(threshold)
        judged = Judged(self._distance, self._unit, threshold.ratios, np.zeros(1))
        self._judged_last = judged
        self._tables = (self.everything.book, judged, threshold.limit, *self._tables)
        self.instrument({})

    @property
    def compiled(self) -> dict[str, Callable[..., Any]]:
        """See `Scorer.compiled`."""
        return {**COMPILED, "judge": self.judge}

    def instrument(self, made: Mapping[str, Callable[..., Any]]) -> None:
        """See `Scorer.instrument`."""
        self.everything.instrument(made)
        self._own = Stored(self.kind, *self._tables)
        given: Callable[..., Any] = made.get("judge", self.judge)
        if is_compiled(given):
            self._judge: Callable[[int], float] = entry(self.judge_at, 0)
        else:
            self._judge = lambda _: given(*self._tables)
        self.at_once = {} if made else self._admissions()

    def _admissions(self) -> dict[str, Callable[[np.ndarray], object]]:
        """See `Scorer.at_once`."""
        found: dict[str, Callable[[np.ndarray], object]] = dict.fromkeys(
            ODOMETRY.values(), self.everything.vehicles.add
        )
        if not is_compiled(self.admit_at):
            return found
        # held as long as its address is used
        own, recent = self._own, self._recent
        self._admitted = own if recent is None else Stored(self.admission, *self._tables, recent)
        for name in self.everything.states.intersection(FREQUENT):
            call = partial(entry(self.admit_at, 0, lent(new_state(name).header)), self._admitted.address)
            found[name] = self.everything.vehicles.settled(call) if self.everything.from_vehicle(name) else call
        return found

    def __getstate__(self) -> dict[str, Any]:
        """Pickle without machine code and addresses, which are valid in one process only."""
        return {name: value for name, value in self.__dict__.items() if name not in _UNPICKLED}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Inverse of `__getstate__`."""
        self.__dict__.update(state)
        self.instrument({})

    def start(self) -> None:
        """Reset the memory at the start of a flight."""
        super().start()
        self.everything.forget()
        self.candidate = None
        if self._recent is not None:
            self._recent.known[:] = False

    def read(self, state: State) -> Reading | None:
        """Measure a publication."""
        return None if self.score(state) is None else self.judged()[0]

    def score(self, state: State) -> float | None:
        """Score of a publication."""
        slot = self._slots.get(state.spec.name)
        if slot is None:
            return None
        self.candidate = state
        self.everything.read(state, slot)
        return self._judge(self._own.address)

    def judged(self) -> tuple[Reading, Verdict]:
        """Reading and verdict of the publication scored last."""
        own, place = self._judged_last, self.everything.book.place
        reading = Reading(own.distance, own.unit, *self.span(int(place[book.SLOT])), int(place[book.REGIME]))
        return reading, Verdict(float(own.score[0]), own.ratios)

    def accept(self, state: State) -> None:
        """Record a published value."""
        if state is not self.candidate:
            if state.spec.name not in self._slots:
                self.everything.note(state)
                return
            self.score(state)
        self.everything.accept()

    def _settle(self) -> None:
        self.everything.settle()
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
        self.everything.forget()
        self.candidate = None

    def not_finite(self, state: State) -> np.ndarray:
        """Indices of the watched fields of a publication that are not finite."""
        return self.everything.not_finite(state)
