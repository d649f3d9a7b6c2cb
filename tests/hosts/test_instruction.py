"""Instruction-level faults in whole flights: counted, drawn, struck in place and in a forked child."""

import json
from dataclasses import replace

import numpy as np
import pytest

from mavfi.faults.instruction import (
    Counting,
    ForkPoint,
    Injecting,
    InstructionFault,
    Resolving,
    Strike,
    budget_for,
    choose,
    plan_flight,
)
from mavfi.hosts.compose import make_scenario
from mavfi.hosts.inprocess import fly
from mavfi.kernels.control import pid
from mavfi.pipeline.functions import PLAIN


def scenario():
    return make_scenario("sparse", 7, start=(2.0, 0.0, 3.0), goal=(9.0, 0.0, 3.0))


def flown_with(twin):
    return fly(scenario(), functions=replace(PLAIN, track=twin))


@pytest.fixture(scope="module")
def golden():
    return fly(scenario()).log


@pytest.fixture(scope="module")
def counted():
    twin = Counting(pid.track)
    flown_with(twin)
    return twin


@pytest.fixture(scope="module")
def places(counted):
    """Call and index of some dynamic instructions of the flight."""
    return choose(np.random.default_rng(3), counted.counts, 120)


@pytest.fixture(scope="module")
def resolved(places, golden):
    wanted = {}
    for call, index in places:
        wanted.setdefault(call, []).append(index)
    twin = Resolving(pid.track, wanted)
    assert flown_with(twin).log.digest() == golden.digest()
    return twin


@pytest.fixture(scope="module")
def planned(counted, resolved, places):
    """The first fault of a class, with another bit if one is given."""

    def make(which, bit=None):
        fault = plan_flight(np.random.default_rng(0), pid.track, counted, resolved, places, 1, which)[0]
        return fault if bit is None else replace(fault, bits=(bit,))

    return make


def test_calls_are_drawn_with_the_weight_of_their_counts():
    counts = [10, 0, 1000, 10]
    drawn = choose(np.random.default_rng(1), counts, 5_000)
    calls = np.bincount([call for call, _ in drawn], minlength=4)
    assert calls[1] == 0
    assert abs(calls[2] - 5_000 * 1000 / 1020) < 200
    assert all(0 <= index < counts[call] for call, index in drawn)
    assert {index for call, index in drawn if call == 0} == set(range(10))


def test_every_drawn_instruction_has_a_site(resolved, places):
    sites = [resolved.sites[place] for place in places]
    assert None not in sites
    assert len({site.opcode for site in sites}) > 3


def test_planned_faults_are_of_their_class(counted, resolved, places):
    arguments = pid.track, counted, resolved, places, 1000
    everything = plan_flight(np.random.default_rng(0), *arguments)
    floating = plan_flight(np.random.default_rng(0), *arguments, which="floating_point", model="zero")
    assert len(everything) == len(places) > len(floating) > 0
    assert all(resolved.sites[fault.call, fault.index].floating and fault.masks == (0, 0) for fault in floating)
    assert all(fault.budget == budget_for(counted.counts[fault.call]) for fault in everything)


def test_a_fault_in_a_flight_strikes_once_and_again_the_same(planned):
    fault = planned("floating_point", bit=61)
    digests, strikes = [], []
    for _ in range(2):
        twin = Injecting(pid.track, fault)
        digests.append(flown_with(twin).log.digest())
        strikes.append(twin.strike())
        assert twin.calls > fault.call
    assert digests[0] == digests[1]
    assert strikes[0] == strikes[1]
    assert strikes[0].hit and strikes[0].before ^ strikes[0].after == 1 << 61
    record = strikes[0].to_json()
    assert record["file"].startswith(("mavfi/", "numba/"))
    assert json.loads(json.dumps(record))["call"] == fault.call


def test_a_fault_beyond_the_last_call_changes_nothing(planned, counted, golden):
    fault = replace(planned("all"), call=len(counted.counts) + 5)
    twin = Injecting(pid.track, fault)
    assert flown_with(twin).log.digest() == golden.digest()
    assert twin.strike() == Strike(fault, hit=False)


@pytest.mark.parametrize(("which", "bit"), [("floating_point", 61), ("address", None)])
def test_a_fault_in_a_forked_child_leaves_the_parent_golden(planned, golden, which, bit):
    """The child finishes the flight with the fault and reports; the parent goes on from the same instant without it."""
    fault = planned(which, bit)
    point, ends = ForkPoint(), []

    def split():
        ended = point.split(timeout=120.0)
        ends.append(ended)
        return ended is None

    twin = Injecting(pid.track, fault, before=split)
    with point.guard():
        flight = flown_with(twin)
        if point.in_child:
            point.finish(flight.log.digest().encode())
    assert flight.log.digest() == golden.digest()
    assert twin.strike().hit
    assert len(ends) == 1
    assert ends[0].how in ("done", "crash", "exception", "hang")
    if which != "address":
        assert (ends[0].how, ends[0].payload.decode()) == ("done", flown_with(Injecting(pid.track, fault)).log.digest())


def test_faults_of_a_flight_survive_json(planned):
    fault = planned("all")
    assert InstructionFault.from_json(json.loads(json.dumps(fault.to_json()))) == fault
