"""Bases of injectors."""

from copy import copy
from typing import Self

from mavfi.record import Injection, KernelEffect
from mavfi.states import State


class Injector:
    """A tap of a flight that injects one fault; by default all publications pass unchanged.

    Attributes:
        spent: Whether all further publications will pass unchanged.
        injections: The injections so far.
        effect: How the kernel or detector crashed after the fault; None = it did not.
    """

    spent = True
    effect: KernelEffect | None = None

    def __call__(self, state: State, time_us: int) -> State | None:
        """The publication as consumers receive it at the current time (us); None = it is lost."""
        del time_us
        return state

    def finish(self) -> list[Injection]:
        """The injections at the end of the flight; one that is not activated if nothing was changed."""
        raise NotImplementedError

    def release(self) -> None:
        """Undo, after the flight, changes of what outlives it."""


class RewindableInjector(Injector):
    """An injector that checkpoints contain."""

    injections: list[Injection]

    def copy(self) -> Self:
        """An independent copy in the same state; subclasses copy what else changes."""
        other = copy(self)
        other.injections = list(self.injections)
        return other
