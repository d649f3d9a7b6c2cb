"""Where callbacks put what came, and where the thread that needs it waits for it."""

import threading
import time
from collections.abc import Hashable
from typing import Any


class Inbox:
    """Things by key; safe between threads."""

    def __init__(self) -> None:
        self._things: dict[Hashable, Any] = {}
        self._changed = threading.Condition()

    def put(self, key: Hashable, thing: Any) -> None:
        """Something came."""
        with self._changed:
            self._things[key] = thing
            self._changed.notify_all()

    def take(self, key: Hashable, patience_s: float) -> Any:
        """Wait for something, and take it out.

        Args:
            key: What.
            patience_s: For how long (s).

        Raises:
            TimeoutError: It did not come.
        """
        end = time.monotonic() + patience_s
        with self._changed:
            while key not in self._things:
                if not self._changed.wait(max(0.0, end - time.monotonic())) and key not in self._things:
                    raise TimeoutError(f"{key} did not come within {patience_s:g} s")
            return self._things.pop(key)
