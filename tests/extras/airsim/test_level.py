"""Faults in the calls of a program are drawn from the calls of its golden run."""

from collections import Counter

from mavfi.campaign.config import Campaign
from mavfi.campaign.resolve import resolve
from mavfi.config import parse
from mavfi.extras.airsim.boundary import PassedCall
from mavfi.extras.airsim.level import CallLevel, CallSampling
from mavfi.flight.host import RunResult
from mavfi.levels.level import Sampled, draws_of
from mavfi.levels.message import MessageLevel, MessageSampling
from mavfi.levels.message.fault import MessageFault
from mavfi.record import End, FlightRecord
from mavfi.testing import HostContract, LevelContract

CALLS = [PassedCall("ping", 0, 1), PassedCall("moveToZ", 8, 1), PassedCall("moveToZ", 8, 1), PassedCall("reset", 0, 0)]
PROGRAM = {"host": "airsim_program", "sampling": {"level": "message"}}


def campaign(**changes):
    data = {**PROGRAM, "name": "c", "program": {"script": "p.py"}, "environments": ["sparse"]}
    return parse(Campaign, {**data, "missions": 1, "faults": 300, **changes}, "campaign.yaml")


def faults(of, calls=CALLS):
    sampler = resolve(of).sampler
    draws = [draw for _, draw in draws_of(sampler.blocks("sparse"), range(1))]
    golden = {"": Sampled(RunResult(FlightRecord(End.FLOWN), tuple(calls)))}
    return sampler.draw(draws, "sparse", golden), sampler, golden


def test_every_call_and_number_of_its_side_is_drawn_and_no_other():
    drawn_faults, _, _ = faults(campaign())
    arguments = [fault for fault in drawn_faults if fault.field.startswith("arguments")]
    returns = [fault for fault in drawn_faults if fault.field.startswith("return")]
    assert len(arguments) == len(returns) == 300 and {fault.topic for fault in arguments} == {"moveToZ"}
    assert {(fault.at, fault.field) for fault in arguments} == {(k, f"arguments#{n}") for k in (1, 2) for n in range(8)}
    share = Counter((fault.topic, fault.at) for fault in returns)
    assert set(share) == {("ping", 1), ("moveToZ", 1), ("moveToZ", 2)} and min(share.values()) > 70
    assert {fault.bit for fault in drawn_faults} == set(range(64))


def test_draws_are_the_same_in_any_share_of_the_work_and_for_some_calls_only():
    drawn_faults, _, _ = faults(campaign())
    assert drawn_faults == faults(campaign())[0] != faults(campaign(first_seed=5))[0]
    some, _, _ = faults(campaign(sampling={"level": "message", "calls": ["ping"], "sides": ["return"]}))
    assert len(some) == 300 and {fault.topic for fault in some} == {"ping"}


def test_without_a_call_there_is_no_fault_and_a_null_run_flips_nothing():
    drawn_faults, sampler, golden = faults(campaign(), calls=CALLS[-1:])
    assert set(drawn_faults) == {None}
    null = faults(campaign())[1].null(0, 10_000, "sparse", faults(campaign())[2])
    assert null.bit is None and null.topic == "moveToZ"
    assert sampler.null(0, 10_000, "sparse", golden).bit is None


class TestMessage(LevelContract):
    level = CallLevel
    faults = [MessageFault("moveToZ", "arguments#2", 5, 3, seed=1)]
    campaign = {"host": "airsim_program", "program": {"script": "p.py"}}
    golden = {"": Sampled(RunResult(FlightRecord(End.FLOWN), tuple(CALLS)))}


class TestProgramHost(HostContract):
    host = "airsim_program"
    under_test = {"script": "p.py"}


def test_the_host_of_programs_draws_calls():
    programs = campaign()
    assert type(programs.sampling) is CallSampling and type(programs.level) is CallLevel
    assert Campaign.model_validate(programs.to_json()) == programs
    assert programs.sampling.to_json() == {"level": "message", "sides": ["arguments", "return"], "calls": []}
    flights = Campaign(name="c", environments=("sparse",), sampling={"level": "message"})
    assert type(flights.sampling) is MessageSampling and type(flights.level) is MessageLevel
