"""PX4's shell over SERIAL_CONTROL, with the commands `failure`, `commander` and `param`.

Forms: https://docs.px4.io/main/en/debug/failure_injection and https://docs.px4.io/main/en/modules/modules_system.
"""

import math
from typing import TYPE_CHECKING, Any

from mavfi.errors import not_known
from mavfi.extras.mavlink.failures import TYPES
from mavfi.extras.mavlink.vocabulary import Command, MavCommand, MavResult, UnsupportedError

if TYPE_CHECKING:
    from mavfi.extras.mavlink.px4 import Px4Autopilot

SHELL = (0, 0)
"""Sender of commands that were typed: their result is printed, not sent."""
_DEVICE = 10  # SERIAL_CONTROL_DEV_SHELL
_REPLY = 1  # SERIAL_CONTROL_FLAG_REPLY
_CHUNK = 70
_LONGEST_LINE = 200
_COMPONENTS = {
    "gyro": 0,
    "accel": 1,
    "mag": 2,
    "baro": 3,
    "gps": 4,
    "optical_flow": 5,
    "vio": 6,
    "distance_sensor": 7,
    "airspeed": 8,
    "battery": 100,
    "motor": 101,
    "servo": 102,
    "avoidance": 103,
    "rc_signal": 104,
    "mavlink_signal": 105,
    "esc": 106,
    "traffic": 107,
}
"""FAILURE_UNIT by PX4's names."""
_FAILURE_FORM = "failure COMPONENT TYPE [-i INSTANCE] [-m MASK]"
_COMMANDER: dict[str, tuple[tuple[int, float], ...]] = {
    "arm": ((MavCommand.ARM_DISARM, 1.0),),
    "disarm": ((MavCommand.ARM_DISARM, 0.0),),
    "takeoff": ((MavCommand.ARM_DISARM, 1.0), (MavCommand.TAKEOFF, math.nan)),
    "land": ((MavCommand.LAND, math.nan),),
}
"""MAV_CMD and first parameter of what `commander` does."""


class Shell:
    """Executes lines, and answers them.

    Args:
        autopilot: Its autopilot.
    """

    def __init__(self, autopilot: "Px4Autopilot") -> None:
        self._autopilot = autopilot
        self._line = ""

    def receive(self, message: Any) -> None:
        """SERIAL_CONTROL: characters, which may be parts of a line."""
        if message.device != _DEVICE:
            raise UnsupportedError(f"{message.get_type()} of device {message.device}")
        text = bytes(message.data[: message.count]).decode("ascii", "replace")
        for character in text:
            if character in "\r\n":
                self._execute(self._line.split())
                self._line = ""
            elif len(self._line) < _LONGEST_LINE:
                self._line += character

    def print(self, text: str) -> None:
        """Send a line."""
        data = f"{text}\n".encode("ascii", "replace")
        for start in range(0, len(data), _CHUNK):
            chunk = data[start : start + _CHUNK]
            self._autopilot.send(
                "serial_control", _DEVICE, _REPLY, 0, 0, len(chunk), [*chunk, *[0] * (_CHUNK - len(chunk))]
            )

    def print_result(self, command: Command, result: int) -> None:
        """Send the result of a command that was typed."""
        self.print(f"command {command.number}: {MavResult(result).name.lower()}")

    def _execute(self, words: list[str]) -> None:
        """Execute a line."""
        if not words:
            return
        commands = {"failure": self._fail, "commander": self._command, "param": self._parameter}
        if words[0] not in commands:
            self.print(not_known(words[0], commands))
            return
        commands[words[0]](words[1:])

    def _fail(self, words: list[str]) -> None:
        """`failure`."""
        names = {name: number for number, name in TYPES.items()}
        options = dict(zip(words[2::2], words[3::2], strict=False))
        if len(words) % 2 or len(words) < 2 or not set(options) <= {"-i", "-m"}:
            self.print(f"allowed: {_FAILURE_FORM}")
            return
        for word, known in ((words[0], _COMPONENTS), (words[1], names)):
            if word not in known:
                self.print(not_known(word, known))
                return
        try:
            mask = float(int(options.get("-m", "0"), 0))
            instance = float(int(options.get("-i", "0")))
        except ValueError:
            self.print(f"allowed: {_FAILURE_FORM}")
            return
        if "-m" in options and "-i" not in options:  # PX4: the mask counts without an instance only
            instance = math.nan
        self._run(MavCommand.INJECT_FAILURE, float(_COMPONENTS[words[0]]), float(names[words[1]]), instance, mask)

    def _command(self, words: list[str]) -> None:
        """`commander`."""
        if len(words) != 1 or words[0] not in _COMMANDER:
            self.print(f"allowed: commander {', '.join(_COMMANDER)}")
            return
        for number, parameter in _COMMANDER[words[0]]:
            self._run(number, parameter)

    def _run(self, number: int, *parameters: float) -> None:
        missing = [math.nan] * (7 - len(parameters))
        self._autopilot.execute(Command(number, (*parameters, *missing), None, SHELL))

    def _parameter(self, words: list[str]) -> None:
        """`param show` and `param set`."""
        parameters = self._autopilot.parameters
        if len(words) == 2 and words[0] == "show" and words[1] in parameters:
            self.print(f"{words[1]}: {parameters[words[1]]:g}")
        elif len(words) == 3 and words[0] == "set" and words[1] in parameters:
            try:
                parameters.set_text(words[1], words[2])
            except ValueError:
                self.print(f"{words[2]}: not a value of {words[1]}")
                return
            self.print(f"{words[1]}: {parameters[words[1]]:g}")
        else:
            self.print("allowed: param show NAME, param set NAME VALUE, of parameters that exist")
