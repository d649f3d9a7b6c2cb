"""The lock-step of a firmware process: time, packets, ports, ends; with a miniature firmware."""

import os
import time
from contextlib import closing, suppress
from pathlib import Path

import pytest

from mavfi.extras.firmware import betaflight, process
from mavfi.extras.firmware.process import FIRST_NS, Firmware, FirmwareLostError

CRASH, HANG, EXIT = 1, 2, 3
"""Values of the last RC channel, on which the miniature misbehaves."""


def run(firmware, periods=1, rate=0.0, channels=None, stop_at=process.NEVER):
    motors = []
    for _ in range(periods):
        state = (rate, *betaflight.AT_REST[1:])
        firmware.run(betaflight.packets(firmware.now_ns, state, channels), betaflight.PERIOD_NS, stop_at)
        motors.append(firmware.motors)
    return motors


def misbehave(how):
    return (1500,) * 15 + (how,)


def test_time_is_virtual_and_advances_by_the_period(firmware):
    assert 0 <= firmware.now_ns - FIRST_NS < 1000
    began = time.monotonic()
    run(firmware, 200)
    assert time.monotonic() - began < 10.0  # a guard against waits for the wall clock, not a measurement
    assert 0 <= firmware.now_ns - FIRST_NS - 200 * betaflight.PERIOD_NS < 100_000


def test_packets_reach_the_firmware_before_it_continues(firmware):
    (motors,) = run(firmware, 1, rate=0.5, channels=(1000, 2000, *(0,) * 14))
    assert motors[:2] == (0.5, 0.75)
    (motors,) = run(firmware, 1, rate=1.0)  # RC stays as it was
    assert motors[:2] == (0.75, 1.0)


def test_two_processes_give_the_same_bytes(programs):
    motors = []
    for _ in range(2):
        with closing(Firmware(*programs, {})) as firmware:
            firmware.wait()
            motors.append(run(firmware, 50, 0.3, misbehave(0)))
    assert motors[0] == motors[1]
    assert len(set(motors[0])) > 1  # its clock is in them


def test_no_port_is_opened(firmware):
    run(firmware, 2)
    sockets = {os.readlink(path) for path in Path(f"/proc/{firmware.pid}/fd").iterdir() if _is_link(path)}
    for table in ("udp", "tcp", "udp6", "tcp6"):
        lines = Path(f"/proc/{firmware.pid}/net/{table}").read_text().splitlines()[1:]
        assert not [line for line in lines if f"socket:[{line.split()[9]}]" in sockets]


def _is_link(path):
    with suppress(OSError):
        return bool(os.readlink(path))
    return False


@pytest.mark.parametrize(
    ("how", "effect", "detail"), [(CRASH, "crash", "SIGSEGV"), (EXIT, "crash", "exit code 3")], ids=["signal", "exit"]
)
def test_the_end_of_the_firmware_is_named(firmware, how, effect, detail):
    with pytest.raises(FirmwareLostError) as caught:
        run(firmware, 3, channels=misbehave(how))
    assert (caught.value.effect, caught.value.detail) == (effect, detail)


@pytest.mark.slow
def test_an_endless_loop_is_a_hang(firmware, monkeypatch):
    monkeypatch.setattr(process, "_HANG_CPU_S", 0.1)
    with pytest.raises(FirmwareLostError, match="hangs"):
        run(firmware, 3, channels=misbehave(HANG))


def test_close_ends_the_process_and_deletes_its_files(programs):
    firmware = Firmware(*programs, {"eeprom.bin": b"content"})
    assert (firmware.folder / "eeprom.bin").read_bytes() == b"content"
    firmware.close()
    firmware.close()
    assert not firmware.folder.exists()
    with pytest.raises(ProcessLookupError):
        os.kill(firmware.pid, 0)


def test_instructions_between_two_calls_are_counted_alike_in_every_period(firmware):
    run(firmware, 3, channels=misbehave(0))
    counts = []
    for _ in range(3):
        run(firmware, 1, stop_at=(2, 10**6))
        counts.append(firmware.instructions)
    assert len(set(counts)) == 1
    assert 5 < counts[0] < 1000
