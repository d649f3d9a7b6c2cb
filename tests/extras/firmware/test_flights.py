"""Betaflight's real firmware flies parts of missions; skipped where it is not installed (docs/how-to/firmware.md)."""

from contextlib import closing
from dataclasses import replace
from functools import partial

import pytest

from mavfi.errors import BadInputError
from mavfi.extras.firmware import betaflight, build
from mavfi.extras.firmware.host import fly, register_fault
from mavfi.extras.firmware.injector import CALLS, WALK
from mavfi.extras.firmware.process import Firmware
from mavfi.flight.compose import resolve
from mavfi.flight.loop import Listener
from mavfi.levels.sensor.fault import SensorFault
from mavfi.mission import MissionSpec, MissionStatus
from mavfi.outcomes import LOST_TILT, ControlEffect, ControlErrors, control_of


@pytest.fixture(scope="session", autouse=True)
def _firmware():
    try:
        build.program()
        build.shim()
    except BadInputError as error:
        pytest.skip(str(error))


def scenario(**keys):
    return resolve(MissionSpec(environment="sparse", seed=7, **{"flight_controller": "betaflight", **keys}))


@pytest.fixture(scope="session")
def golden(_firmware):
    return fly(scenario())


def test_a_whole_mission_succeeds(golden):
    assert golden.log.status is MissionStatus.SUCCESS
    assert golden.log.column("time")[-1] < 45.0


def test_instructions_between_two_calls_stay_below_the_bound_of_the_draw():
    needed, longest = build.installed(), 0
    with closing(Firmware(needed.program, needed.shim, {betaflight.EEPROM: needed.configuration})) as firmware:
        betaflight.arm(firmware, betaflight.AT_REST)
        for call in range(CALLS):
            channels = None if call % 4 else betaflight.ARMED
            packets = betaflight.packets(firmware.now_ns, betaflight.AT_REST, channels)
            assert not firmware.run(packets, betaflight.PERIOD_NS, (call, 10**9))  # counts, and never stops
            longest = max(longest, firmware.instructions)
    assert 1_000 < longest <= WALK


def test_a_fault_is_repeated_to_the_last_bit_and_its_null_run_is_golden(golden):
    struck = [fly(scenario(), register_fault(3_000_000, 5)).log for _ in range(2)]
    assert struck[0].injections[0].activated
    assert struck[0].injections == struck[1].injections
    assert struck[0].digest() == struck[1].digest()
    null = fly(scenario(), replace(register_fault(3_000_000, 5), null=True)).log
    assert null.injections[0].activated
    assert null.digest() == golden.log.digest()


class BeforeTakeOff(Listener):
    def __init__(self, change):
        self.begin = change


def test_a_vehicle_whose_rotors_stop_is_out_of_control_without_tilting(golden):
    struck = fly(scenario(), observers=(BeforeTakeOff(partial(_stop_rotors, 3_000_000)),))
    errors = ControlErrors.of(struck.record())
    assert struck.log.status is MissionStatus.COLLISION
    assert errors.velocity > 3.0 and errors.tilt < LOST_TILT
    assert control_of(golden.record(), struck.record()) is ControlEffect.LOST


def _stop_rotors(time_us, loop):
    rotors = loop.plant.controller.rotors
    loop.plant.controller.rotors = lambda now, *rest: rotors(now, *rest) * (now < time_us)


@pytest.mark.long
def test_a_failure_of_a_sensor_reaches_the_firmware(golden):
    log = fly(scenario(), SensorFault("gyro", "wrong", 3_000_000)).log
    assert log.injections[0].activated and log.digest() != golden.log.digest()
    assert (log.rows[:151] == golden.log.rows[:151]).all()
    null = fly(scenario(), SensorFault("accelerometer", "ok", 3_000_000)).log
    assert null.injections[0].activated and null.digest() == golden.log.digest()
