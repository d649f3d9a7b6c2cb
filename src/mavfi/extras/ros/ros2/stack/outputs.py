"""Outputs of a stack as plain data: comparison with those of the error-free run, and the verdict on them."""

import hashlib
import importlib.util
import json
import math
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

from mavfi.errors import BadInputError
from mavfi.extras.ros.ros2.stack.config import StackConfig
from mavfi.mission import MissionStatus

LOST = "lost"
"""Status of a mission whose verdict is false."""
_MAX_DIFFERENCES = 4
_VERDICT_LIMIT_S = 60.0

Outputs = Mapping[str, Sequence[Any]]
"""Messages in their order, as plain data, by topic."""


@dataclass(frozen=True, slots=True)
class Difference:
    """A value that differs from that of the error-free run.

    Attributes:
        topic: Topic of the message.
        message: Its number, counted from 1.
        field: Path of the value; "" = the whole message, which is missing or surplus.
        golden: Its error-free value as text.
        value: Its value as text.
    """

    topic: str
    message: int
    field: str
    golden: str
    value: str


class Comparison(NamedTuple):
    """What differs: number of messages, and the first values."""

    differing: int
    differences: tuple[Difference, ...]


def leaves(data: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Single values of plain data, with their paths."""
    if isinstance(data, Mapping):
        for name, value in data.items():
            yield from leaves(value, f"{path}.{name}".lstrip("."))
    elif isinstance(data, list):
        for index, value in enumerate(data):
            yield from leaves(value, f"{path}[{index}]")
    else:
        yield path, data


def digest_of(outputs: Outputs) -> str:
    """Hash of all outputs."""
    return hashlib.sha256(json.dumps(outputs, sort_keys=True).encode()).hexdigest()


def compare(golden: Outputs, outputs: Outputs, stack: StackConfig) -> Comparison:
    """Compare the outputs of a run with the error-free ones, message by message."""
    differing = 0
    first: list[Difference] = []
    for output in stack.outputs:
        expected = golden.get(output.topic, ())
        received = outputs.get(output.topic, ())
        for index in range(max(len(expected), len(received))):
            if index >= len(received):
                unequal = [("", "a message", "none")]
            elif index >= len(expected):
                unequal = [("", "none", "a message")]
            else:
                unequal = list(_unequal(expected[index], received[index], output.tolerance))
            differing += bool(unequal)
            first += [Difference(output.topic, index + 1, *values) for values in unequal]
    return Comparison(differing, tuple(first[:_MAX_DIFFERENCES]))


def _unequal(golden: Any, value: Any, tolerance: float) -> Iterator[tuple[str, str, str]]:
    """Path and both values of whatever differs in a message."""
    before = dict(leaves(golden))
    after = dict(leaves(value))
    for path in dict.fromkeys([*before, *after]):
        old = before.get(path)
        new = after.get(path)
        if not _is_close(old, new, tolerance):
            yield path, repr(old), repr(new)


def _is_close(golden: Any, value: Any, tolerance: float) -> bool:
    """Whether two values count as equal; NaN equals NaN, 0 and -0 differ."""
    if not isinstance(golden, float) or not isinstance(value, float):
        return type(golden) is type(value) and bool(golden == value)
    if math.isnan(golden) or math.isnan(value):
        return math.isnan(golden) and math.isnan(value)
    if tolerance > 0.0:
        return abs(golden - value) <= tolerance or golden == value
    return golden == value and math.copysign(1.0, golden) == math.copysign(1.0, value)


# ---- the user's verdict ----------------------------------------------------------------------------------------------
def status_of(stack: StackConfig, outputs: Outputs) -> str:
    """The status of a run's mission by the user's verdict; "" without one.

    Raises:
        BadInputError: There is no such function, or it fails.
    """
    if not stack.verdict:
        return ""
    if isinstance(stack.verdict, str):
        answer = _called(stack.verdict, outputs)
    else:
        answer = _exit_code(stack.verdict, outputs) == 0
    if isinstance(answer, str):
        return answer
    if answer:
        return MissionStatus.SUCCESS.label
    return LOST


def _called(verdict: str, outputs: Outputs) -> object:
    """What the user's function says about the outputs."""
    try:
        return _function(verdict)({topic: list(messages) for topic, messages in outputs.items()})
    except BadInputError:
        raise
    except Exception as error:  # noqa: BLE001 - whatever a user's function raises
        raise BadInputError(f"stack.verdict: {verdict}: {type(error).__name__}: {error}") from None


@cache
def _function(verdict: str) -> Any:  # noqa: ANN401 - the user's own
    """The function of a verdict, "FILE.py:FUNCTION"."""
    path, _, name = verdict.rpartition(":")
    spec = importlib.util.spec_from_file_location("mavfi_verdict", path)
    if not path.endswith(".py") or spec is None or spec.loader is None:
        raise BadInputError(f"stack.verdict: {verdict!r}: allowed: FILE.py:FUNCTION, or a command as a list of words")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
        return getattr(module, name)
    except Exception as error:  # noqa: BLE001 - whatever a user's module raises
        raise BadInputError(f"stack.verdict: {verdict}: {type(error).__name__}: {error}") from None


def _exit_code(command: Sequence[str], outputs: Outputs) -> int:
    try:
        return subprocess.run(
            command, input=json.dumps(outputs).encode(), check=False, timeout=_VERDICT_LIMIT_S
        ).returncode
    except (OSError, subprocess.TimeoutExpired) as error:
        raise BadInputError(f"stack.verdict: {command[0]}: {error}") from None
