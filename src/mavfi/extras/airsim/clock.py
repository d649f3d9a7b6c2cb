"""How simulated time passes: with wall-clock time, times a factor (`Real`), or in calls only (`Steps`).

With `Steps`, every call takes a fixed time, waiting and sleeping take theirs, and nothing else takes any: a program
with the same seed sees the same bytes.  `runner` replaces sleeping, waiting and clocks of a program by calls.
"""

import time

from mavfi.extras.airsim.config import CALL_US
from mavfi.extras.airsim.table import Api
from mavfi.sim.scene import STEP_US


class Steps:
    """Time passes in calls.

    Attributes:
        limit_us: No time passes beyond this instant.
        waited_us: Time that the program spent while the simulation was paused; part of its clocks.
    """

    def __init__(self, call_us: int = CALL_US, limit_us: int = 10**15) -> None:
        self._call_us, self.limit_us = call_us, limit_us
        self.waited_us = 0

    def before_call(self, api: Api) -> None:
        """Let the time of a call pass."""
        self._pass(api, self._call_us)

    def after_call(self, api: Api) -> None:
        """Let time pass up to the next pause, if the call asked for that."""
        if api.resume_until_us is not None:
            api.vehicle.step(min(self.limit_us, api.resume_until_us))
            api.paused, api.resume_until_us = True, None

    def sleep(self, api: Api, seconds: float) -> None:
        """The program sleeps."""
        self._pass(api, max(STEP_US, round(seconds * 1e6 / STEP_US) * STEP_US))

    def now(self, api: Api) -> int:
        """Time of the program (us); reading a clock takes the time of a call, so that polling ends."""
        self._pass(api, self._call_us)
        return api.vehicle.now_us + self.waited_us

    def finish(self, api: Api) -> None:
        """The program waits for its task."""
        if api.paused:
            self._pass(api, self._call_us)  # nobody can end the pause: the task does not end either
            return
        api.vehicle.finish(self.limit_us)

    def _pass(self, api: Api, duration_us: int) -> None:
        if api.paused:
            self.waited_us += duration_us
            return
        api.vehicle.step(min(self.limit_us, api.vehicle.now_us + duration_us))


class Real:
    """Time passes with wall-clock time, times `speed`."""

    def __init__(self, speed: float = 1.0) -> None:
        self._speed = speed
        self._last = time.perf_counter()
        self._left_us = 0.0

    def before_call(self, api: Api) -> None:
        """See `Steps.before_call`; a call takes no simulated time."""

    def after_call(self, api: Api) -> None:
        """See `Steps.after_call`; `tick` lets time pass."""

    def tick(self, api: Api) -> None:
        """Let the time since the last tick pass."""
        now = time.perf_counter()
        self._left_us += 1e6 * self._speed * (now - self._last)
        self._last = now
        if api.paused:
            self._left_us = 0.0
            return
        steps = int(self._left_us // STEP_US)
        target = api.vehicle.now_us + steps * STEP_US
        self._left_us -= steps * STEP_US
        if api.resume_until_us is not None and target >= api.resume_until_us:
            target, api.paused, api.resume_until_us = api.resume_until_us, True, None
        api.vehicle.step(target)
