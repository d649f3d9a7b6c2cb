"""Numbers that count messages or tell the time: they grow whatever the vehicle does, and are no signal."""

import re
from collections.abc import Sequence

import numpy as np

COUNTS = "counts messages or time (see --kinds)"
"""Reason against such a number."""
_NAME = re.compile(
    r"(^|[^a-z])(seq|sequence|counter|count|index|idx|iteration|iter|frame|id|n|no|nr|num|number|record|rec|line|row"
    r"|packets?|msgs?|ticks?|sample)[^a-z]*$|^(column|unnamed:) \d+$"
)
"""Last words of names of counters, in lower case; `column 1` and `unnamed: 0` are numbers of rows."""
_TIME_NAME = re.compile(r"time|stamp|clock|sec|elapsed|epoch|(^|_)t($|_)")
"""What names of times hold, in lower case."""
_RANGES = (256.0, 1e3, 65_536.0, 1e6, 1e9, 2.0**32)
"""Where counters, and the fractions of a second, begin again at 0."""
_USUAL_SHARE = 0.9
"""Share of the messages of a counter with its usual step."""
_GROWING_SHARE = 0.5
"""Share of the messages in which numbers named like a counter grow."""
_FALLING_SHARE = 0.01
"""The same where they begin again."""
_MIN_MESSAGES = 10
_CLOCK_RATES = (1.0, 1e3, 1e6, 1e9)
"""Growth of clocks per second, by their units."""
_CLOCK_DRIFT = 1e-3
"""Largest relative difference between the rates of a clock and of the log."""
_CLOCK_JITTER_S = 0.05
"""Largest difference between a clock and the time of the log, in nearly all messages (s)."""
_MIN_SECONDS = 10
"""Shortest log in which a count of whole seconds can be distinguished from other numbers (s)."""


def counts(name: str, columns: Sequence[np.ndarray], times_us: Sequence[np.ndarray]) -> bool:
    """Whether a number counts messages, or the time.

    Args:
        name: Its name.
        columns: Its values in each recording.
        times_us: Times of the messages (us), in each recording.
    """
    pairs = []
    for values, times in zip(columns, times_us, strict=True):
        is_finite = np.isfinite(values)
        if is_finite.sum() >= _MIN_MESSAGES:
            pairs.append((values[is_finite], times[is_finite]))
    if not pairs:
        return False
    text = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", re.split(r"[./]", name)[-1]).lower()
    is_time_name = _TIME_NAME.search(text) is not None
    is_counter_name = _NAME.search(text) is not None
    if all(_is_clock(values, times, is_time_name=is_time_name) for values, times in pairs):
        return True
    return all(_is_counter(values, is_counter_name=is_counter_name) for values, _ in pairs)


def _is_counter(values: np.ndarray, *, is_counter_name: bool) -> bool:
    """Whether whole numbers grow by the same step from message to message, or are named so and grow in most."""
    if not (values == np.floor(values)).all():
        return False
    if is_counter_name:
        steps = np.diff(values)
        return bool(np.mean(steps > 0.0) >= _GROWING_SHARE and np.mean(steps < 0.0) <= _FALLING_SHARE)
    growing = _unwrapped(values)
    if growing is None:
        return False
    steps = np.diff(growing)
    usual = float(np.median(steps))
    return usual > 0.0 and float(np.mean(steps == usual)) >= _USUAL_SHARE


def _is_clock(values: np.ndarray, times_us: np.ndarray, *, is_time_name: bool) -> bool:
    """Whether whole numbers, or numbers named like a time, grow with the time of the log in a unit of time."""
    growing = values
    quantum = 0.0
    if (values == np.floor(values)).all():
        unwrapped = _unwrapped(values)
        if unwrapped is None:
            return False
        growing = unwrapped
        quantum = 1.0
    elif not is_time_name:
        return False
    passed_s = 1e-6 * (times_us - times_us[0]).astype(np.float64)
    for rate in _CLOCK_RATES:
        if rate * passed_s[-1] < _MIN_SECONDS * max(quantum, _CLOCK_JITTER_S * rate):
            continue
        difference = growing - rate * passed_s
        error = float(np.quantile(np.abs(difference - np.median(difference)), 0.99))
        if error <= max(quantum, _CLOCK_JITTER_S * rate) + _CLOCK_DRIFT * rate * passed_s[-1]:
            return True
    return False


def _unwrapped(values: np.ndarray) -> np.ndarray | None:
    """Whole numbers that never fall, unless at the end of their range, which is added; None = others."""
    steps = np.diff(values)
    falls = steps < 0.0
    if falls.any():
        # A range of at least the largest value, of which no step is a large part.
        limit = next((limit for limit in _RANGES if limit > values.max()), 0.0)
        steps = np.where(falls, steps + limit, steps)
        if values.min() < 0.0 or steps.min() < 0.0 or steps.max() > 0.5 * limit:
            return None
    growing: np.ndarray = values[0] + np.concatenate([[0.0], np.cumsum(steps)])
    return growing
