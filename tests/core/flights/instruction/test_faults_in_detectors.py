"""Faults in instructions of a detector: drawn, injected, and never the end of a flight."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from mavfi.analysis.runs import Runs
from mavfi.analysis.views import table
from mavfi.campaign.config import Campaign
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.detectors.acceptance import AcceptanceTest
from mavfi.detectors.detector import Chain, part_of
from mavfi.detectors.gate import SOURCE as GATE
from mavfi.detectors.preprocess import PROFILES
from mavfi.detectors.registry import check_kernel, contains, load_detector
from mavfi.errors import BadInputError
from mavfi.flight.compose import detector_for, new_loop, resolve, watch
from mavfi.flight.from_take_off import fly_instruction_faults
from mavfi.flight.restarts import Restarts
from mavfi.flight.state import EventKind
from mavfi.levels.instruction.drawing import InstructionRequest, draw_instruction_faults
from mavfi.mission import MissionSpec, MissionStatus
from mavfi.states import DETECTORS, new_state
from tests.campaigns import run_campaign
from tests.core.unit.detectors.streams import LIMITS, command
from tests.core.unit.detectors.test_registry import FITS
from tests.night import at_night


def detector(name, profile="paper"):
    return load_detector(name, profile, None, {**FITS, "limits": LIMITS["published"]})[0]


WITH_GATE = "gaussian"


@pytest.mark.parametrize(
    ("name", "profile"),
    [
        (name, profile)
        for name in DETECTORS
        for profile in PROFILES
        if contains(name if name != GATE else WITH_GATE, profile, name)
    ],
)
def test_the_table_names_the_functions_of_each_detector(name, profile):
    part = part_of(detector(WITH_GATE if name == GATE else name, profile), name)
    assert tuple(part.compiled) == DETECTORS[name]
    calls = []

    def counting(function):
        return lambda *args: calls.append(function) or function(*args)

    part.instrument({function: counting(compiled) for function, compiled in part.compiled.items()})
    state = command([9e9, 0, 0])
    if hasattr(part, "seal"):
        part.seal(state, 0)
    alarm = part.check(state, 0)
    call_count = len(calls)
    assert set(calls) < set(part.compiled.values()) or set(calls) == set(part.compiled.values()) != set()
    part.instrument({})
    assert part.check(state.copy(), 0) == alarm
    assert len(calls) == call_count


def test_a_configuration_names_the_detector_whose_instructions_can_be_struck():
    with pytest.raises(BadInputError, match="'recommended': is a configuration of 'acceptance', whose instructions"):
        check_kernel("recommended", "rrt_connect", Chain(detector("acceptance")))


def test_a_detector_can_be_hit_where_it_watches_alone():
    check_kernel("acceptance", "rrt_connect", Chain(detector("acceptance")))
    for other in (None, detector("gaussian")):
        with pytest.raises(
            BadInputError, match="'acceptance': is not part of this mission.*with acceptance, recommended"
        ):
            check_kernel("acceptance", "rrt_connect", other)


def test_the_refusal_names_the_profile_in_which_the_gate_stands():
    with pytest.raises(BadInputError, match=r"'physics_gate'.*allowed: with .*gaussian \(profile tuned\)"):
        check_kernel(GATE, "rrt_connect", detector("gaussian"))


@pytest.mark.parametrize("policy", ["end", "fresh", "readback"])
def test_a_dead_detector_is_silent_and_comes_back_with_the_last_publications(policy):
    loop = new_loop(resolve(MissionSpec(environment="sparse", seed=7)))
    watching = AcceptanceTest(LIMITS["published"])
    watch(loop, watching)
    tap, restarts = loop.taps.detector, Restarts(loop, policy)
    last = new_state("perception.collision_status")
    last.header["future_collision_seq"] = 3
    loop.taps.recorders[-1](last, 0)
    restarts.detector_dies(watching, 1_000, 500_000)
    assert loop.taps.detector is None
    queued = [event[:1] + event[2:3] for event in loop.state.queue]
    assert queued == ([] if policy == "end" else [(501_000, EventKind.CALL)])
    assert loop.status is None
    if queued:
        ((_, _, _, (comes_back,)),) = loop.state.queue
        comes_back(501_000)
        assert loop.taps.detector is tap
        assert int(watching.record["counters"][0, 1]) == 3


@pytest.mark.slow
@pytest.mark.parametrize("name", ["gaussian", *at_night("acceptance", "limits", "checksum")])
def test_a_flight_continues_whatever_becomes_of_its_detector(name):
    scenario = resolve(MissionSpec(environment="sparse", seed=7, dead_node="readback"))
    watching, _ = detector_for(scenario, name, "paper")
    drawn = draw_instruction_faults(scenario, InstructionRequest({name: 3}), "test", seed=1, detector=watching)
    (counts,) = drawn.counts.values()
    assert counts["calls"] > 1_000 and counts["instructions"] > 10 * counts["calls"]
    faults = drawn.faults[name]
    hanging = replace(faults[0], budget=1)
    flown = fly_instruction_faults(scenario, [*faults, hanging], watching)
    assert flown.golden.log.digest() == drawn.golden.log.digest()
    assert [flight.log.status for flight in flown.flights] == [MissionStatus.SUCCESS] * 4
    assert flown.flights[-1].log.kernel.effect == "hang"
    assert flown.flights[-1].log.digest() == flown.golden.log.digest(), "nothing depends on a silent detector"
    assert np.array_equal(flown.golden.log.rows, drawn.golden.log.rows)


@pytest.mark.slow  # counts the instructions of two golden flights
def test_a_campaign_injects_a_detector_in_its_arm_and_counts_it(tmp_path):
    mission = {"start": (2.0, 0.0, 3.0), "goal": (9.0, 0.0, 3.0)}
    campaign = Campaign(
        name="watched",
        environments=("sparse",),
        missions=1,
        faults=2,
        mission=mission,
        sampling={"level": "instruction", "kernels": ["pid", "gaussian"]},
        arms={"gad": {"detector": "gaussian"}},
    )
    assert run_campaign(campaign, tmp_path, executor=LocalExecutor(1)).complete
    runs = Runs.read(tmp_path)
    assert Counter(zip(runs.injected["kernel"], runs.injected["setting"], strict=True)) == {
        ("pid", "fi"): 2,
        ("pid", "dr_gad"): 2,
        ("gaussian", "dr_gad"): 2,
    }
    assert len(runs.injected.where("judged", kernel="gaussian", activated=True)) == 2
    counts = {row["arm"]: runs.records[row["run_id"]].counts for row in runs.golden}
    assert set(counts[""]) == {"pid"} and set(counts["gad"]) == {"pid", "gaussian"}
    assert counts["gad"]["gaussian"]["instructions"] > counts["gad"]["pid"]["instructions"] > 0
    rows = table(runs, "failures_per_hour").entries()
    assert [(row["setting"], row["kernel"]) for row in rows] == [
        ("fi", "pid"),
        ("fi", "all"),
        ("dr_gad", "pid"),
        ("dr_gad", "gaussian"),
        ("dr_gad", "all"),
    ]
