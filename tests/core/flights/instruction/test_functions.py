"""Instruction-level faults in whole flights: counted, drawn and resolved."""

import json
from dataclasses import replace

import numpy as np
import pytest

from mavfi.faults.fault import fault_from_json
from mavfi.faults.levels.instruction import (
    Profiling,
    Resolving,
    budget_for,
    choose,
)
from mavfi.faults.levels.instruction.plan import plan
from mavfi.faults.levels.instruction.table import parse_selection
from mavfi.flight.compose import resolve
from mavfi.flight.fly import fly
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
    counting = Profiling(pid.track)
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
    """The first fault of a class."""

    def make(which):
        call, index = next(place for place in places if resolved.sites[place] in parse_selection(which))
        return plan(
            np.random.default_rng(0),
            name_of(pid.track),
            counted.digests[call],
            resolved.sites[call, index],
            index,
            call=call,
            which=which,
            budget=budget_for(counted.counts[call]),
        )

    return make


def test_every_drawn_instruction_has_a_site(resolved, places):
    sites = [resolved.sites[place] for place in places]
    assert None not in sites
    assert len({site.opcode for site in sites}) > 3


def test_faults_of_a_flight_survive_json(planned):
    fault = planned("all")
    assert fault_from_json(json.loads(json.dumps(fault.to_json()))) == fault
