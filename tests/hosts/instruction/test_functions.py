"""Instruction-level faults in whole flights: counted, drawn, injected in place and in a forked child."""

import json
from dataclasses import replace

import numpy as np
import pytest

from mavfi.faults.fault import fault_from_json
from mavfi.faults.instruction import (
    Counting,
    ForkPoint,
    Injecting,
    Resolving,
    budget_for,
    choose,
)
from mavfi.faults.instruction.plan import plan
from mavfi.faults.instruction.selection import parse_selection
from mavfi.hosts.local import fly
from mavfi.hosts.loop.compose import resolve
from mavfi.ir.build import name_of
from mavfi.kernels.control import pid
from mavfi.mission import MissionSpec
from mavfi.pipeline.functions import PLAIN


def scenario():
    return resolve(MissionSpec(environment="sparse", seed=7, start=(2.0, 0.0, 3.0), goal=(9.0, 0.0, 3.0)))


def flown_with(function):
    return fly(scenario(), functions=replace(PLAIN, track=function))


@pytest.fixture(scope="module")
def golden():
    return fly(scenario()).log


@pytest.fixture(scope="module")
def counted():
    counting = Counting(pid.track)
    flown_with(counting)
    return counting


@pytest.fixture(scope="module")
def places(counted):
    """Call and index of some dynamic instructions of the flight."""
    return choose(np.random.default_rng(3), counted.counts, 120)


@pytest.fixture(scope="module")
def resolved(places, golden):
    wanted = {}
    for call, index in places:
        wanted.setdefault(call, []).append(index)
    resolving = Resolving(pid.track, wanted)
    assert flown_with(resolving).log.digest() == golden.digest()
    return resolving


@pytest.fixture(scope="module")
def planned(counted, resolved, places):
    """The first fault of a class, with another bit if one is given."""

    def make(which, bit=None):
        call, index = next(place for place in places if resolved.sites[place] in parse_selection(which))
        fault = plan(
            np.random.default_rng(0), name_of(pid.track), counted.digests[call], resolved.sites[call, index], index,
            call=call, which=which, budget=budget_for(counted.counts[call]),
        )  # fmt: skip
        return fault if bit is None else replace(fault, bits=(bit,))

    return make


def test_every_drawn_instruction_has_a_site(resolved, places):
    sites = [resolved.sites[place] for place in places]
    assert None not in sites
    assert len({site.opcode for site in sites}) > 3


def test_a_fault_in_a_flight_is_injected_once_and_again_the_same(planned):
    fault = planned("floating_point", bit=61)
    digests, injections = [], []
    for _ in range(2):
        injecting = Injecting(pid.track, fault)
        digests.append(flown_with(injecting).log.digest())
        injections.append(injecting.injection().to_json())
        assert injecting.calls > fault.call
    assert digests[0] == digests[1]
    assert injections[0] == injections[1]
    record = json.loads(json.dumps(injections[0]))
    details = record["details"]
    assert record["activated"] and int(details["before_bits"], 16) ^ int(details["after_bits"], 16) == 1 << 61
    assert record["file"].startswith(("mavfi/", "numba/"))
    assert details["call"] == fault.call


def test_a_fault_beyond_the_last_call_changes_nothing(planned, counted, golden):
    fault = replace(planned("all"), call=len(counted.counts) + 5)
    injecting = Injecting(pid.track, fault)
    assert flown_with(injecting).log.digest() == golden.digest()
    injection = injecting.injection()
    assert not injection.activated and injection.before is None


@pytest.mark.parametrize(("which", "bit"), [("floating_point", 61), ("address", None)])
def test_a_fault_in_a_forked_child_leaves_the_parent_golden(planned, golden, which, bit):
    """The child finishes the flight with the fault and reports; the parent continues from that instant without it."""
    fault = planned(which, bit)
    point, ends = ForkPoint(), []

    def split():
        ended = point.split(timeout=120.0)
        ends.append(ended)
        return ended is None

    injecting = Injecting(pid.track, fault, before=split)
    with point.guard():
        flight = flown_with(injecting)
        if point.in_child:
            point.finish(flight.log.digest().encode())
    assert flight.log.digest() == golden.digest()
    assert injecting.injection().activated
    assert len(ends) == 1
    assert ends[0].how in ("done", "crash", "exception", "hang")
    if which != "address":
        assert (ends[0].how, ends[0].payload.decode()) == ("done", flown_with(Injecting(pid.track, fault)).log.digest())


def test_faults_of_a_flight_survive_json(planned):
    fault = planned("all")
    assert fault_from_json(json.loads(json.dumps(fault.to_json()))) == fault
