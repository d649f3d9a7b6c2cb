"""A firmware process in lock-step: it runs to a given instant of virtual time, and waits there for the next packets.

The process opens no port, and ends with this one; any number run side by side.  See `lockstep.c`.
"""

import ctypes
import functools
import os
import signal
import socket
import struct
import subprocess
import tempfile
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from mavfi.errors import MavfiError

FIRST_NS = 1_000_000_000
"""Virtual time at which the process starts."""
_REPORT = struct.Struct("<QQQQII4f")  # struct from_firmware of `lockstep.c`
_HEAD = struct.Struct("<QQQ")  # of struct to_firmware
_ARRIVED = 1
"""Event of a report: stopped in front of the wanted instruction."""
_FOLLOW_EVERY = 64
"""Periods between two looks at the CPU of this process."""
_POLL_S = 1
"""Time between two looks at a firmware that is silent."""
_HANG_CPU_S = 2.0
"""Processor time after which a period never ends (s); it takes 0.1 ms."""
_HANG_WALL_S = 20.0
"""Time after which a period that only waits never ends (s)."""
_EXIT_WAIT_S = 2.0
"""Longest wait for a firmware that is to exit (s)."""
_LIBC = ctypes.CDLL(None)
_CPU_FIELDS = slice(11, 13)  # utime and stime, counted from the state, in /proc/PID/stat


class FirmwareLostError(MavfiError):
    """The firmware ended or hangs.

    Attributes:
        effect: "crash" or "hang", as labels of `mavfi.outcomes.Effect`.
        detail: Signal or exit code; "" for a hang.
    """

    def __init__(self, effect: str, detail: str = "") -> None:
        if effect == "hang":
            super().__init__("the firmware hangs")
        else:
            super().__init__(f"the firmware ended ({detail})")
        self.effect = effect
        self.detail = detail


@functools.cache
def fixed_addresses() -> tuple[str, ...]:
    """Command that runs a program at the same addresses each time; empty where that is not permitted.

    Flights do not depend on addresses, but flips that make an address wild may.
    """
    command = ("setarch", "-R")
    with suppress(OSError):
        if subprocess.run([*command, "true"], capture_output=True, check=False).returncode == 0:
            return command
    return ()


class StopPoint(NamedTuple):
    """Where the main thread of a firmware stops in a period.

    Attributes:
        call: Number of its call of the shim in this period, from 0.
        instruction: Number of the instruction after this call, from 0.
    """

    call: int
    instruction: int


NEVER = StopPoint(2**64 - 1, 0)
"""It does not stop."""


class Firmware:
    """A process in lock-step; must be closed.

    Attributes:
        pid: Its process id.
        folder: Its working directory, deleted by `close`.
        now_ns: Virtual time at which it waits.
        motors: Its last motor commands, 0 to 1, in its own order. Length 4.
        calls: Number of its main thread's calls of the shim in this period.
        instructions: Number of instructions counted in this period, see `run`.
        address: Address of the next instruction, if it has stopped at one.
        shim: Its preloaded library.
    """

    def __init__(self, program: Path, shim: Path, files: Mapping[str, bytes], msp: socket.socket | None = None) -> None:
        """Start the program; after `wait` it expects its first packets.

        Args:
            program: The firmware's binary.
            shim: `lockstep.c`, compiled.
            files: Content of files in its working directory, by name.
            msp: Listening socket in place of its serial port; None = it has none.
        """
        self._folder = tempfile.TemporaryDirectory(prefix="mavfi-firmware-")
        self.folder = Path(self._folder.name)
        self.shim = shim
        for name, content in files.items():
            (self.folder / name).write_bytes(content)
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("ll", _POLL_S, 0))
        # Numbers of fixed width: the size of the environment moves the stack, which wild addresses may hit.
        shared = [theirs.fileno()]
        environment = {"LD_PRELOAD": str(shim), "LOCKSTEP_CHANNEL": f"{theirs.fileno():06d}"}
        if msp is not None:
            shared.append(msp.fileno())
            environment["LOCKSTEP_MSP"] = f"{msp.fileno():06d}"
        # It inherits nothing else.
        with theirs:
            self._process = subprocess.Popen(
                [*fixed_addresses(), str(program), "127.0.0.1"],
                cwd=self.folder,
                env=environment,
                pass_fds=shared,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
        self.pid = self._process.pid
        self.now_ns = 0
        self.calls = 0
        self.instructions = 0
        self.address = 0
        self.motors: tuple[float, ...] = (0.0,) * 4
        self._periods = 0
        self._cpu = -1

    def run(self, packets: bytes, period_ns: int, stop_at: StopPoint = NEVER) -> bool:
        """Run the next period; True = its main thread has stopped at an instruction before the end.

        Args:
            packets: Sensor and RC packets, `struct to_firmware` of `lockstep.c` from `has_rc` on.
            period_ns: Length of the period.
            stop_at: Where its main thread stops; if the next call of the shim comes first, it does not.

        Raises:
            FirmwareLostError: The process ended or hangs.
        """
        self._periods += 1
        if self._periods % _FOLLOW_EVERY == 0:
            self._follow()
        self._send(_HEAD.pack(self.now_ns + period_ns, *stop_at) + packets)
        return self.wait()

    def _follow(self) -> None:
        """Move its threads to this process's CPU: the two never run at once, and a switch between CPUs costs more."""
        cpu = _LIBC.sched_getcpu()
        if cpu == self._cpu:
            return
        self._cpu = cpu
        with suppress(OSError):  # it has ended, or may not be moved
            for thread in os.listdir(f"/proc/{self.pid}/task"):
                os.sched_setaffinity(int(thread), {cpu})

    def resume(self) -> None:
        """Let it continue from the instruction at which it has stopped, for `wait`."""
        self._send(b"\0")

    def _send(self, content: bytes) -> None:
        """Send to the firmware; the error names how it ended."""
        try:
            self._socket.send(content)
        except OSError:
            raise self.loss() from None

    def wait(self) -> bool:
        """Wait until the current period is over; True = it has stopped at an instruction before.

        Raises:
            FirmwareLostError: The process ended or hangs.
        """
        data = self._receive()
        if len(data) < _REPORT.size:
            raise self.loss()
        self.now_ns, self.calls, self.instructions, self.address, event, _, *motors = _REPORT.unpack(data)
        self.motors = tuple(motors)
        return bool(event == _ARRIVED)

    def _receive(self) -> bytes:
        """The next report; a FirmwareLostError if it takes too long."""
        cpu = 0.0
        end = time.monotonic() + _HANG_WALL_S
        while True:
            try:
                return self._socket.recv(_REPORT.size)
            except BlockingIOError:  # SO_RCVTIMEO, which spares the poll of `settimeout`
                cpu = cpu or self._cpu_s()  # at the first silence
                if self._cpu_s() - cpu > _HANG_CPU_S or time.monotonic() > end:
                    raise FirmwareLostError("hang") from None

    def loss(self, code: int | None = None) -> FirmwareLostError:
        """How the process ended, given its exit code (negative = signal) if a tracer has waited for it."""
        if code is None:
            try:
                code = self._process.wait(_EXIT_WAIT_S)
            except subprocess.TimeoutExpired:
                return FirmwareLostError("hang")
        if code < 0:
            return FirmwareLostError("crash", signal.Signals(-code).name)
        return FirmwareLostError("crash", f"exit code {code}")

    def close(self) -> None:
        """End the process, and delete its files; may be called twice."""
        self._socket.close()
        with suppress(ProcessLookupError):
            self._process.kill()
        self._process.wait()
        self._folder.cleanup()

    def _cpu_s(self) -> float:
        """Processor time used so far (s); 0 if the process has ended."""
        try:
            fields = Path(f"/proc/{self.pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        except OSError:
            return 0.0
        return sum(map(int, fields[_CPU_FIELDS])) / os.sysconf("SC_CLK_TCK")
