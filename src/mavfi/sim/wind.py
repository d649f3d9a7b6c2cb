"""Wind: a constant mean and gusts of the form "1 - cosine" (MIL-F-8785C, section 3.7.1.3), a function of seed and time.

The specification's gust rises along a flown distance; a hovering multirotor covers none, so lengths are seconds here.
It rises by half a cosine and falls by the other half, like a gust flown through completely.  Two gusts are separated by
a calm of random length; so they never overlap, and their amplitude is never exceeded.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mavfi.config import WindConfig, parse
from mavfi.numerics.elementary import asin, cos, log, sin
from mavfi.numerics.jit import kernel_jit

GUST_WIDTH = 5
"""Columns of a gust's record: onset (s), duration (s), and peak velocity x y z (m/s), world frame."""

_SHORTEST_SHARE = 0.5
_LONGEST_SHARE = 1.5
"""Bounds of a gust's duration / the configured one."""
_STEEPEST = 0.2
"""Largest vertical share of a gust's amplitude."""
_AT_A_TIME = 32
"""Gusts that are drawn together: compiled code is given a longer table of them only now and then."""


class Wind(NamedTuple):
    """Wind data for compiled code.

    Attributes:
        mean: World frame (m/s). Shape (3,).
        gusts: In order of onset. Shape (n, GUST_WIDTH).
    """

    mean: np.ndarray
    gusts: np.ndarray


@kernel_jit
def wind_at(wind: Wind, time: float, velocity: np.ndarray) -> None:
    """Velocity of the air.

    Args:
        wind: Mean and gusts.
        time: Since the start of the flight (s).
        velocity: Output, world frame (m/s). Shape (3,).
    """
    velocity[0], velocity[1], velocity[2] = wind.mean[0], wind.mean[1], wind.mean[2]
    for n in range(len(wind.gusts)):
        since = time - wind.gusts[n, 0]
        if not since > 0.0:
            return  # this one and all later ones have not started
        duration = wind.gusts[n, 1]
        if since < duration:
            share = 0.5 * (1.0 - cos(2.0 * math.pi * since / duration))
            for axis in range(3):
                velocity[axis] += share * wind.gusts[n, 2 + axis]


class Weather:
    """The wind of one flight: gusts are drawn in order as time advances, without a fixed end."""

    def __init__(self, config: WindConfig, seed: np.random.SeedSequence) -> None:
        """Prepare without drawing gusts.

        Args:
            config: Amplitude, mean, calm and length.
            seed: Seed of the gusts' random stream.
        """
        self._config = config
        self._random = np.random.default_rng(seed)
        self._end = 0.0
        self._wind = Wind(np.array(config.mean, float), np.zeros((0, GUST_WIDTH)))

    def until(self, time: float) -> Wind:
        """The wind at least up to an instant.

        Args:
            time: Since the start of the flight (s).
        """
        while self._config.gust > 0.0 and self._end <= time:
            drawn = [self._draw() for _ in range(_AT_A_TIME)]
            self._wind = Wind(self._wind.mean, np.concatenate([self._wind.gusts, drawn]))
        return self._wind

    def set_mean(self, mean: Sequence[float]) -> None:
        """Change the mean wind, world frame (m/s).

        Raises:
            BadInputError: It is not finite, or too strong.
        """
        checked = parse(WindConfig, {"mean": list(mean)}, "wind")
        self._wind = Wind(np.array(checked.mean, float), self._wind.gusts)

    def _draw(self) -> tuple[float, ...]:
        """Draw the next gust, a row of `Wind.gusts`; the calm before it is distributed exponentially."""
        calm, share, direction, rise = self._random.random(4)
        onset = self._end - self._config.interval * log(1.0 - calm)
        duration = self._config.length * (_SHORTEST_SHARE + (_LONGEST_SHARE - _SHORTEST_SHARE) * share)
        slope = asin(_STEEPEST * (2.0 * rise - 1.0))
        level = self._config.gust * cos(slope)
        angle = 2.0 * math.pi * direction
        self._end = onset + duration
        return (
            onset,
            duration,
            level * cos(angle),
            level * sin(angle),
            self._config.gust * sin(slope),
        )
