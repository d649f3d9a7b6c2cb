"""Register faults in a firmware: exact place, exact replay; with a miniature firmware."""

import math
from collections import Counter
from contextlib import closing
from dataclasses import replace

import pytest

from mavfi.extras.firmware import betaflight, injector
from mavfi.extras.firmware.host import register_fault
from mavfi.extras.firmware.injector import FirmwareInjector
from mavfi.extras.firmware.process import Firmware, FirmwareLostError

PERIODS = 60


@pytest.fixture(autouse=True)
def _small_periods(monkeypatch):
    """The miniature has 20 rounds with 3 calls in a period, and few instructions between them."""
    monkeypatch.setattr(injector, "CALLS", 64)


def fault(seed, time_us=0, **given):
    return replace(register_fault(time_us, seed), walk=128, **given)


def fly(programs, planned):
    """Motors of each period, the injection, and how the firmware ended."""
    injector, motors = FirmwareInjector(planned), []
    with closing(Firmware(*programs, {})) as firmware:
        firmware.wait()
        try:
            for period in range(PERIODS):
                state = (0.01 * period, *betaflight.AT_REST[1:])
                packets = betaflight.packets(firmware.now_ns, state, (1500,) * 16)
                if firmware.run(packets, betaflight.PERIOD_NS, injector.stop_at(1000 * period)):
                    injector.inject(firmware, 1000 * period)
                motors.append(firmware.motors)
        except FirmwareLostError as lost:
            return motors, injector.finish()[0], (lost.effect, lost.detail)
    return motors, injector.finish()[0], None


def test_draws_are_uniform_over_the_instructions_of_a_period():
    lengths = [5, 100, 1, 60]  # instructions after each call
    firmware_injector = FirmwareInjector(fault(1))
    draws = [firmware_injector.stop_at(0) for _ in range(60_000)]
    hits = Counter(call for call, instruction in draws if call < len(lengths) and instruction < lengths[call])
    each = 60_000 / (injector.CALLS * 128)
    for call, length in enumerate(lengths):
        assert abs(hits[call] - each * length) < 5.0 * math.sqrt(each * length) + 1.0


@pytest.fixture(scope="session")
def golden(programs):
    return fly(programs, fault(0, time_us=10**9))[0]


@pytest.mark.parametrize("seed", range(6))
def test_a_fault_is_repeated_to_the_last_bit(programs, seed):
    first, second = fly(programs, fault(seed)), fly(programs, fault(seed))
    assert first[1].activated
    assert first == second


def test_a_fault_changes_exactly_its_bit_in_a_register_of_the_instruction(programs, golden):
    _, injection, _ = fly(programs, fault(1))
    assert int(injection.before, 16) ^ int(injection.after, 16) == 1 << injection.bit
    assert injection.details["register"] == injection.site
    assert injection.details["node"] == "firmware"


def test_a_null_fault_leaves_the_flight_as_it_is(programs, golden):
    motors, injection, end = fly(programs, fault(2, null=True))
    assert injection.activated
    assert injection.before == injection.after
    assert motors == golden
    assert end is None


def test_a_fault_waits_for_its_instant(programs, golden):
    motors, injection, _ = fly(programs, fault(3, time_us=30_000))
    assert injection.time_s >= 0.03
    assert motors[:30] == golden[:30]


def test_no_injection_is_in_the_shim_and_effects_differ(programs, golden):
    runs = [fly(programs, fault(seed)) for seed in range(20, 34)]
    libraries = Counter(injection.details["library"] for _, injection, _ in runs)
    assert str(programs[1]) not in libraries
    assert libraries[str(programs[0])] > 0
    ends = Counter("lost" if end else "same" if motors == golden else "other" for motors, _, end in runs)
    assert len(ends) > 1, ends
