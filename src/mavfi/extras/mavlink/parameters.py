"""Parameters of the autopilot, by MAVLink's parameter protocol; integers are encoded bytewise, like PX4's."""

import struct
from collections.abc import Callable
from typing import Any

_INT32, _REAL32 = 6, 9
_DEFAULTS: dict[str, float | int] = {
    "COM_RC_IN_MODE": 4, "MIS_TAKEOFF_ALT": 2.5, "MPC_XY_CRUISE": 5.0, "NAV_DLL_ACT": 0, "SYS_AUTOSTART": 4001,
    "SYS_FAILURE_EN": 1, "SYS_HITL": 0,
}  # fmt: skip


class Parameters:
    """Values by name, those of PX4 that client programs ask for."""

    def __init__(self) -> None:
        self._values = dict(_DEFAULTS)

    def __getitem__(self, name: str) -> float:
        return float(self._values[name])

    def answer(self, message: Any, send: Callable[..., None]) -> None:
        """Answer PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET; unknown names are ignored."""
        names = list(self._values)
        kind = message.get_type()
        if kind == "PARAM_REQUEST_LIST":
            wanted = names
        elif kind == "PARAM_REQUEST_READ" and message.param_index >= 0:
            wanted = names[message.param_index : message.param_index + 1]
        elif kind in ("PARAM_REQUEST_READ", "PARAM_SET"):
            wanted = [message.param_id] if message.param_id in self._values else []
        else:
            return
        for name in wanted:
            if kind == "PARAM_SET":
                whole = isinstance(self._values[name], int)
                self._values[name] = _from_wire(message.param_value) if whole else float(message.param_value)
            value = self._values[name]
            whole = isinstance(value, int)
            encoded = struct.unpack("<f", struct.pack("<i", value))[0] if whole else value
            send("param_value", name.encode(), encoded, _INT32 if whole else _REAL32, len(names), names.index(name))


def _from_wire(value: float) -> int:
    found: int = struct.unpack("<i", struct.pack("<f", value))[0]
    return found
