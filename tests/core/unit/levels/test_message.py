"""Faults in whole messages are drawn from the publications of golden runs; hosts may draw them otherwise."""

from collections import Counter

import numpy as np
import pytest

from mavfi.campaign.config import Campaign
from mavfi.campaign.resolve import resolve
from mavfi.faults.fault import NO_SITE
from mavfi.flight.host import Flight
from mavfi.levels.level import Sampled, parse
from mavfi.levels.message import MessageLevel
from mavfi.levels.state.fault import StateFault
from mavfi.record import Profile
from mavfi.states import PPC_STAGES, STATES

PATH = "planning.path"
PROFILE = Profile({PATH: np.arange(100, 150)}, {PATH: np.zeros(50, np.int32)})


def campaign(**sampling):
    content = {"name": "c", "environments": ("sparse",), "missions": 300, "faults": 300}
    return Campaign(**content, sampling={"level": "message", **sampling})


def drawn(of, profile=PROFILE):
    sampler = resolve(of).sampler
    drawn_faults = []
    for block in sampler.blocks("sparse"):
        draws = [block.draw(index) for index in range(block.count)]
        drawn_faults.append(sampler.draw(draws, "sparse", {"": Sampled(Flight(None, profile))}))
    return drawn_faults


def test_publications_and_operations_are_uniform():
    operations = ["drop:times=2", "delay=0.2", "duplicate=3"]
    (faults,) = drawn(campaign(states=[PATH], operations=operations))
    counts = Counter(MessageLevel().columns(fault)["operation"] for fault in faults)
    assert set(counts) == set(operations) and min(counts.values()) > 70
    assert {fault.time_us for fault in faults} <= set(range(100, 150)) and len({f.time_us for f in faults}) > 40
    assert {(fault.topic, fault.field, fault.stratum) for fault in faults} == {(PATH, "", "")}
    assert faults == drawn(campaign(states=[PATH], operations=operations))[0]


def test_each_state_of_the_pipeline_has_its_faults_by_default_or_none_without_a_publication():
    drawn_faults = drawn(campaign())
    states = [spec.name for spec in STATES.values() if spec.stage in PPC_STAGES and not spec.only_with]
    assert [faults[0].topic for faults in drawn_faults] == states
    for state, faults in zip(states, drawn_faults, strict=True):
        assert {fault.has_site for fault in faults} == {state == PATH}
    assert {fault.time_us for fault in drawn_faults[0]} == {NO_SITE}


def test_null_runs_have_an_empty_mask():
    null = resolve(campaign()).sampler.null(1, 5, "sparse", {"": Sampled(Flight(None, PROFILE))})
    assert isinstance(null, StateFault) and null.is_null and null.where.state.startswith("planning.")


@pytest.mark.parametrize(
    ("sampling", "message"),
    [
        (
            {"states": ["planning.pth"]},
            r"sampling.states: 'planning.pth': not known \(did you mean 'planning.path'\?\)",
        ),
        ({"states": [PATH, PATH]}, "named 2 times; allowed: once"),
        ({"states": ["sensor.imu"]}, "sensor.imu is published with localization estimator only, not truth"),
        ({"operations": ["set=1"]}, "sampling.operations: 'set=1': .*set: allowed: drop, delay"),
        ({"operations": ["drop@3"]}, "sampling.operations: .*the instant is drawn; allowed: without @"),
        ({"calls": ["hover"]}, "calls"),
    ],
)
def test_what_cannot_be_drawn_is_refused(sampling, message):
    with pytest.raises(ValueError, match=message):
        campaign(**sampling)


def test_the_instant_that_is_not_given_is_that_of_a_publication():
    request = parse("message:planning.path:drop")
    instants = {request.resolve(seed, PROFILE).time_us for seed in range(200)}
    assert instants <= set(range(100, 150)) and len(instants) > 40
