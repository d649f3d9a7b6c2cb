"""Failures of sensors and motors in whole flights: nothing before them, proof of activation, replay, campaigns."""

from functools import cache

import pytest

import mavfi
from mavfi.analysis.runs import Runs
from mavfi.campaign.config import Campaign
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.replay import explain
from mavfi.errors import BadInputError
from mavfi.flight.compose import new_loop
from mavfi.flight.fly import fly
from mavfi.levels.sensor.fault import UNITS, SensorFault
from mavfi.levels.sensor.injector import SensorInjector
from mavfi.report.explain import steps
from tests.campaigns import run_campaign
from tests.core.flights.missions import golden, mission

pytestmark = pytest.mark.slow
AT = 2_000_000
ROWS = AT // 20_000
KINDS = {"gyro": "off", "compass": "wrong", "position": "drift", "depth_camera": "delayed", "motor": "intermittent"}


@cache
def golden_with_estimator():
    return fly(mission(localization="estimator"))


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("localization", ["truth", "estimator"])
def test_a_flight_is_golden_until_the_failure_starts_and_proves_that_it_did(unit, localization):
    if (unit, localization) == ("accelerometer", "truth"):
        pytest.skip("nothing reads it")
    plain = golden() if localization == "truth" else golden_with_estimator()
    fault = SensorFault(unit, KINDS.get(unit, "wrong"), AT, 2.0, instance=1 if unit == "motor" else 0, seed=1)
    log = fly(mission(localization=localization), fault).log
    assert (log.rows[: ROWS + 1] == plain.log.rows[: ROWS + 1]).all() and log.digest() != plain.log.digest()
    (injection,) = log.injections
    assert injection.activated and (injection.level, injection.site) == ("sensor", fault.site)
    assert AT <= 1e6 * injection.time_s < AT + 1_000_000 and injection.before != injection.after
    again = fly(mission(localization=localization), fault).log
    assert (again.digest(), again.injections) == (log.digest(), log.injections)


@pytest.mark.parametrize("unit", [unit for unit in UNITS if unit != "accelerometer"])
def test_a_null_fault_has_the_digest_of_the_golden_run(unit):
    log = fly(mission(), SensorFault(unit, "ok", AT)).log
    assert log.digest() == golden().log.digest() and log.injections[0].activated


def test_a_failure_after_the_end_is_not_activated():
    log = fly(mission(), SensorFault("gyro", "off", 10**9)).log
    assert log.digest() == golden().log.digest() and not log.injections[0].activated


def test_a_device_that_nothing_reads_is_refused():
    with pytest.raises(BadInputError, match="accelerometer: localization truth and our flight controller do not read"):
        fly(mission(), SensorFault("accelerometer", "off", AT))


def test_motors_of_a_server_are_refused():
    loop = new_loop(mission())
    del loop.plant.controller
    with pytest.raises(BadInputError, match="motor off: the motors are the server's; allowed with --world: sensors"):
        SensorInjector(loop, SensorFault("motor", "off"))


def test_on_the_command_line_the_instant_is_drawn_from_the_golden_run():
    drawn = mavfi.draw("sensor:motor2:off", environment="dense", seed=1, goal=(45.0, 5.0, 3.0))
    assert (drawn.unit, drawn.instance, drawn.kind) == ("motor", 2, "off")
    assert 0 < 1e-6 * drawn.time_us < golden().log.column("time")[-1]


@pytest.mark.long
def test_a_campaign_is_the_same_on_any_number_of_workers_and_every_run_can_be_explained(tmp_path):
    campaign = Campaign(
        name="c",
        environments=("sparse",),
        missions=2,
        faults=2,
        null_runs=1,
        sampling={"level": "sensor", "units": ["gyro", "motor"], "types": ["off", "drift"]},
    )
    digests = []
    for workers in (1, 2):
        run_campaign(campaign, tmp_path / str(workers), executor=LocalExecutor(workers))
        digests.append(Runs.read(tmp_path / str(workers)).campaign["digest"])
    assert digests[0] == digests[1]
    frame = Runs.read(tmp_path / "1").injected.frame
    assert sorted(frame["state"].to_list()) == ["gyro", "gyro", "motor", "motor"]
    assert sorted(set(frame["field"].to_list())) == ["drift", "off"] and frame["activated"].all()
    explanation = explain(tmp_path / "1", frame["run_id"][0])
    assert explanation.same
    story = dict(
        steps(
            explanation.flight.log,
            explanation.golden.log,
            explanation.spec.fault,
            "",
            explanation.first,
            explanation.departure,
        )
    )
    assert explanation.spec.fault.site in story["fault"] and "to the end" in story["fault"]
