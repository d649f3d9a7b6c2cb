"""Progress of a campaign in one line, for notebooks and scripts; the command line has a bar (`cli.progress`)."""

import sys
import time
from datetime import timedelta
from importlib import import_module
from typing import Any, Self

from mavfi.campaign.ledger import Progress

_UPDATE_EVERY = 0.5
"""Least interval between updates of the progress (s): a notebook keeps up with a few messages a second."""


class ProgressLine:
    """Progress of a campaign in one line that is updated: in a notebook, or on stderr of a terminal; else nowhere.

    It is called with the progress after every run.
    """

    def __init__(self, label: str) -> None:
        """Prepare without showing anything.

        Args:
            label: What is being flown.
        """
        self._label = label
        self._output = _output_of_notebook()
        self._is_shown = self._output is not None or sys.stderr.isatty()
        self._has_line = False
        self._started = time.perf_counter()
        self._next_update = 0.0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._has_line and self._output is None:
            sys.stderr.write("\n")

    def __call__(self, progress: Progress) -> None:
        """Show the progress if the last update is old enough, or if it is complete."""
        now = time.perf_counter()
        if not self._is_shown or (now < self._next_update and not progress.complete):
            return
        self._next_update = now + _UPDATE_EVERY
        self._write(f"{self._label}: {self._text(progress, now - self._started)}")
        self._has_line = True

    def _text(self, progress: Progress, elapsed_s: float) -> str:
        """Runs that are done, and the time left at the mean rate of this session, which has lasted `elapsed_s`."""
        if progress.compiling and not progress.flown:
            return "compiling kernels and flying the first mission ..."
        text = f"{progress.done} of {progress.total} runs"
        if progress.complete or not progress.flown:
            return text
        left_s = elapsed_s * (progress.total - progress.done) / progress.flown
        return f"{text}, {timedelta(seconds=round(left_s))} left"

    def _write(self, line: str) -> None:
        """Replace the line that was shown."""
        if self._output is None:
            sys.stderr.write(f"\r{line}\x1b[K")
            sys.stderr.flush()
        elif self._has_line:
            self._output.update({"text/plain": line}, raw=True)
        else:
            self._output.display({"text/plain": line}, raw=True)


def _output_of_notebook() -> Any:
    """A display of a notebook whose content can be replaced; None outside of notebooks."""
    ipython = sys.modules.get("IPython")
    if ipython is None or getattr(ipython.get_ipython(), "kernel", None) is None:
        return None
    return import_module("IPython.display").DisplayHandle()
