"""Flights with a fault in an instruction of a kernel: drawn, injected in a forked child, judged; the node restarted."""

import os
from dataclasses import asdict, replace

import numpy as np
import pytest

from mavfi.campaign import divergence
from mavfi.campaign.divergence import TimedState
from mavfi.errors import BadInputError
from mavfi.flight.compose import resolve
from mavfi.flight.fly import fly
from mavfi.flight.from_take_off import fly_instruction_faults
from mavfi.flight.instruction_cases import Output, first_difference
from mavfi.flight.mission_flights import fly_recorded
from mavfi.ir.forked import WILD, run_in_child
from mavfi.ir.injection.variant import MismatchError, variant_for
from mavfi.levels import instruction
from mavfi.levels.instruction.drawing import InstructionRequest, draw_instruction_faults
from mavfi.levels.instruction.plan import stratum_of
from mavfi.mission import MissionSpec
from mavfi.numerics.jit import kernel_jit
from mavfi.record import plain


def scenario(**options):
    return resolve(MissionSpec(environment="sparse", seed=7, start=(2.0, 0.0, 3.0), goal=(9.0, 0.0, 3.0), **options))


@pytest.fixture(scope="module")
def golden():
    return fly(scenario()).log


@pytest.fixture(scope="module")
def drawn():
    return draw_instruction_faults(scenario(), InstructionRequest({"pid": 12, "point_cloud": 4}, which="data"), seed=3)


@pytest.fixture(scope="module")
def flown(drawn):
    return fly_instruction_faults(scenario(), [*drawn.faults["pid"], *drawn.faults["point_cloud"]])


def in_addresses(kernel, number, bit=46):
    wish = InstructionRequest({kernel: number}, which="opcode:getelementptr", restart_s=0.2)
    faults = draw_instruction_faults(scenario(), wish, seed=1).faults[kernel]
    return [replace(fault, bits=(bit,)) for fault in faults]


def test_counting_and_injecting_leave_the_golden_flight_as_it_is(golden, drawn, flown):
    assert drawn.golden.log.digest() == flown.golden.log.digest() == golden.digest()
    counted = drawn.counts["pid"]
    assert counted["calls"] == len(golden.rows) - 1
    assert sum(count for _, _, count in counted["lines"]) == counted["instructions"] > 100 * counted["calls"]
    assert all(file == "mavfi/kernels/control/pid.py" or "/numerics/" in file for file, _, _ in counted["lines"])


def test_the_same_faults_give_the_same_bytes_alone_and_together(drawn, flown):
    for number in (0, 7, 13):
        fault = [*drawn.faults["pid"], *drawn.faults["point_cloud"]][number]
        alone = fly_instruction_faults(scenario(), [fault]).flights[0].log
        together = flown.flights[number].log
        assert alone.digest() == together.digest()
        assert [i.to_json() for i in alone.injections] == [i.to_json() for i in together.injections]
        assert plain(asdict(alone.kernel)) == plain(asdict(together.kernel)), "a NaN is not equal to itself"


def test_every_record_is_of_an_injection_and_names_the_source(drawn, flown):
    for flight in flown.flights:
        (injection,) = flight.log.injections
        assert injection.activated
        assert injection.details["value_class"] in ("floating_point", "integer")
        assert injection.file.startswith("mavfi/") and injection.line > 0
        assert len(injection.details["ir_sha256"]) == 64
        assert repr(injection.before) != repr(injection.after)
    assert {flight.log.injections[0].site for flight in flown.flights} == {"pid.track", "point_cloud.back_project"}


def test_masked_means_the_golden_flight_and_sdc_of_a_command_another_one(golden, flown):
    effects = [(f.log.kernel, f.log.digest() == golden.digest()) for f in flown.flights]
    assert all(same for kernel, same in effects if kernel.effect == "masked")
    assert {kernel.effect for kernel, _ in effects} == {"masked", "sdc"}
    commands = [
        same
        for kernel, same in effects
        if (kernel.first_difference or {}).get("state") == "control.command"
        and kernel.first_difference["field"] in ("vx", "vy", "vz")
    ]
    assert commands and not any(commands)


def test_publications_of_an_injected_flight_are_recorded_without_a_change_of_it(drawn, flown):
    golden = [TimedState(time_us, state) for state, time_us in fly_recorded(scenario())[1]]
    effects = [flight.log.kernel for flight in flown.flights]
    faults = [*drawn.faults["pid"], *drawn.faults["point_cloud"]]
    masked = next(index for index, effect in enumerate(effects) if effect.effect == "masked")
    wrong = next(index for index, effect in enumerate(effects) if effect.first_difference)
    for index in (masked, wrong):
        flight, published = fly_recorded(scenario(), faults[index])
        assert flight.log.digest() == flown.flights[index].log.digest()
        seen = [TimedState(time_us, state) for state, time_us in published]
        difference, reported = divergence.first_difference(golden, seen), effects[index].first_difference
        if reported is None:
            assert difference is None and len(seen) == len(golden)
        else:
            late_us = difference.time_us - round(1e6 * flight.log.injections[0].time_s)
            assert difference.state == reported["state"] and 0 <= late_us < 10_000, (
                "published at the end of the injected step"
            )
            assert difference.field.startswith(reported["field"])


@pytest.mark.slow
def test_a_crash_ends_the_mission_or_restarts_the_node(golden):
    faults = in_addresses("point_cloud", 2)
    before = len(os.listdir("/proc/self/fd"))
    flights = fly_instruction_faults(scenario(), faults).flights
    assert len(os.listdir("/proc/self/fd")) <= before, "a pipe or a process handle was left open"
    with pytest.raises(ChildProcessError):
        os.waitpid(-1, os.WNOHANG)
    crashed = [flight.log for flight in flights if flight.log.kernel.effect == "crash"]
    assert crashed
    for log in crashed:
        assert log.kernel.detail == WILD
        assert len(log.rows) > 1
        clouds = [flight.meta["publications"]["perception.point_cloud"] for flight in (log, golden)]
        assert 0 < clouds[0] <= clouds[1], "the node came back, and what it computed when it died was lost"


@pytest.mark.slow
def test_a_node_that_never_comes_back_is_missed(golden):
    fault = in_addresses("pid", 1)[0]
    dead = replace(fault, restart_s=60.0)
    log = fly_instruction_faults(scenario(), [dead]).flights[0].log
    if log.kernel.effect != "crash":
        pytest.skip("this bit of the address does not crash here")
    assert log.status is not golden.status
    assert log.meta["publications"]["control.command"] < golden.meta["publications"]["control.command"]


def test_a_fault_of_other_machine_code_is_refused(drawn):
    fault = drawn.faults["pid"][0]
    with pytest.raises(MismatchError, match="drawn for IR 000000000000"):
        fly_instruction_faults(scenario(), [replace(fault, ir_sha256="0" * 64)])


def test_a_class_that_is_not_executed_has_no_site(golden):
    fault = draw_instruction_faults(scenario(), InstructionRequest({"pid": 1}, which="opcode:udiv"), seed=1).faults[
        "pid"
    ][0]
    assert not fault.has_site
    log = fly_instruction_faults(scenario(), [fault]).flights[0].log
    assert log.digest() == golden.digest()
    assert log.kernel.effect == "not_activated"
    assert not log.injections[0].activated


@pytest.mark.parametrize(
    ("kernel", "message"),
    [
        ("rrt", "the planner of this mission is 'rrt_connect'; allowed: planner rrt"),
        ("lidar", "not known; allowed: point"),
    ],
)
def test_kernels_that_cannot_be_injected_are_named(kernel, message):
    with pytest.raises(BadInputError, match=message):
        draw_instruction_faults(scenario(), InstructionRequest({kernel: 1}), seed=1)


@pytest.mark.parametrize(
    ("kind", "bit", "stratum"),
    [
        ("double", 63, "sign"),
        ("double", 52, "exponent"),
        ("double", 51, "mantissa"),
        ("float", 31, "sign"),
        ("float", 23, "exponent"),
        ("float", 22, "mantissa"),
        ("<4 x double>", 127, "sign"),
        ("<4 x double>", 64, "mantissa"),
        ("i64", 63, "other"),
        ("ptr", 5, "other"),
        ("double", None, "other"),
    ],
)
def test_bits_have_strata(kind, bit, stratum):
    assert stratum_of(kind, bit) == stratum


def test_first_difference_names_field_element_and_size():
    dtype = np.dtype([("x", "<f8"), ("n", "<i4")])
    header, elements = np.zeros(1, dtype), np.zeros(4, dtype)
    other = elements.copy()
    other["x"][[1, 3]] = 2.0, -5.0
    golden, injected = Output({"a.b": (header, elements)}, b""), Output({"a.b": (header, other)}, b"")
    difference = first_difference(golden, injected)
    assert (difference["state"], difference["field"], difference["element"]) == ("a.b", "x", 1)
    assert (difference["before"], difference["after"], difference["elements"], difference["largest"]) == (
        0.0,
        2.0,
        2,
        5.0,
    )
    assert first_difference(golden, golden) is None
    shorter = first_difference(golden, Output({"a.b": (header, elements[:3])}, b""))
    assert (shorter["field"], shorter["before"], shorter["after"]) == ("elements", 4, 3)
    other["x"][3] = np.nan
    assert first_difference(golden, injected)["largest"] == np.inf
    assert not golden.same(Output({"a.b": (header, elements)}, b"other"))


def test_workers_do_not_report_into_each_other():
    """Forks of one parent share what it has mapped; a worker that injects makes memory of its own first."""
    numbers = np.arange(3.0)

    @kernel_jit
    def total(values):
        result = 0.0
        for value in values:
            result += value
        return result

    here, there = instruction.draw(total, 2, numbers, which="floating_point", seed=1)
    assert instruction.run_forked(total, here, numbers).injection.activated
    variant = variant_for(total, (numbers,))
    before = variant.report()
    ended = run_in_child(lambda: bytes([instruction.run_forked(total, there, numbers).injection.activated]))
    assert ended.payload == b"\x01"
    assert variant.report() == before
