"""Standard output while a command runs: it holds what the command answers, and nothing that plug-ins print."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

_STDOUT = 1
_STDERR = 2


class _Answer:
    """Where the answer of the command goes that runs in this process.

    Attributes:
        is_running: Whether a command runs; a program of the user's own keeps its output.
        stream: The answer's stream, once standard output is that of plug-ins; None = standard output.
    """

    is_running = False
    stream: TextIO | None = None


def answer_stream() -> TextIO:
    """The stream of what a command answers: a pipe from it receives no other text."""
    return _Answer.stream or sys.stdout


@contextmanager
def answering() -> Iterator[None]:
    """A command runs; at the end standard output is what it was."""
    stdout = sys.stdout
    _Answer.is_running = True
    try:
        yield
    finally:
        stream = _Answer.stream
        _Answer.stream = None
        _Answer.is_running = False
        sys.stdout = stdout
        if stream is not None and stream is not stdout:
            stream.flush()
            os.dup2(stream.fileno(), _STDOUT)


def divert_prints() -> None:
    """Let what others' code prints go to standard error, before it is imported.

    Their libraries in C write to the descriptor, as do processes that they start.
    """
    stdout = sys.stdout
    if not _Answer.is_running or _Answer.stream is not None or stdout is None:
        return
    _Answer.stream = stdout
    try:
        has_descriptor = stdout.fileno() == _STDOUT
    except (OSError, ValueError):  # a stream in memory
        has_descriptor = False
    if has_descriptor:
        stdout.flush()
        _Answer.stream = os.fdopen(os.dup(_STDOUT), "w", encoding=stdout.encoding, errors=stdout.errors)
        os.dup2(_STDERR, _STDOUT)
    sys.stdout = sys.stderr
