"""Faults in what kernels remember, in whole flights: the right bit, the right instant, and nothing else."""

import dataclasses
import pickle

import numpy as np
import pytest

from mavfi.detectors.detector import part_of
from mavfi.errors import BadInputError
from mavfi.faults import strata
from mavfi.faults.changes import ValueChange
from mavfi.faults.operations import Operation
from mavfi.flight.compose import detector_for, new_loop
from mavfi.flight.decide import RecoveryPolicy
from mavfi.flight.fly import fly
from mavfi.flight.host import ArmSetup
from mavfi.levels.memory.exposure import fly_exposed
from mavfi.levels.memory.fault import MemoryFault
from mavfi.levels.memory.injector import ArrayMemory, MemoryInjector
from mavfi.levels.memory.request import MemoryRequest
from mavfi.mission import MissionStatus
from mavfi.pipeline.waypoints import SetpointGenerator
from mavfi.pipeline.words import change, words_of
from mavfi.states import KERNELS, WATCHING, new_state
from tests.core.flights.missions import golden, mission

pytestmark = pytest.mark.slow
AT = 4_000_000
KERNELS_FLOWN = [name for name, spec in KERNELS.items() if not spec.only_with]
COUNTER = MemoryFault("planner", "decisions.acted_seq", None, "i4", AT, 20)


def struck(fault, until=AT):
    """A loop with a fault before the control period of an instant, and one without."""
    loops = []
    for one in (fault, None):
        loop = new_loop(mission())
        if one is not None:
            loop.taps.injector = MemoryInjector(loop, one)
        loop.begin()
        loop.run(until // 20_000)
        loops.append(loop)
    return loops


def differing(one, other):
    """Kernels that remember something else."""
    return [name for name in one.kernels if one.kernels[name].fingerprint() != other.kernels[name].fingerprint()]


@pytest.mark.parametrize("until", [AT - 20_000, AT])
def test_one_word_of_one_kernel_changes_at_the_instant_and_not_before(until):
    loop, twin = struck(COUNTER, until)
    assert differing(loop, twin) == (["planner"] if until == AT else [])
    if until == AT:
        decisions, golden_ones = loop.kernels["planner"].memory.decisions, twin.kernels["planner"].memory.decisions
        assert decisions.acted_seq == golden_ones.acted_seq ^ 1 << 20
        decisions.acted_seq = golden_ones.acted_seq
        assert differing(loop, twin) == []


def test_the_record_says_what_was_changed():
    log = fly(mission(), COUNTER).log
    (injection,) = log.injections
    assert (injection.level, injection.site) == ("memory", "memory:planner.decisions.acted_seq")
    assert injection.activated and injection.time_s == 4.0 and injection.bit == 20
    assert injection.after == injection.before ^ 1 << 20
    assert fly(mission(), COUNTER).log.digest() == log.digest()


def test_an_empty_mask_changes_nothing():
    flight = fly(mission(), dataclasses.replace(COUNTER, bit=None))
    assert flight.log.digest() == golden().log.digest()
    (injection,) = flight.log.injections
    assert injection.activated and injection.before == injection.after


@pytest.mark.parametrize(
    "fault",
    [
        dataclasses.replace(COUNTER, field="decisions.nothing"),
        dataclasses.replace(COUNTER, time_us=10**9),
        dataclasses.replace(COUNTER, time_us=-1),
        MemoryFault("state_estimation", "aligned", None, "?", AT, 0),
        MemoryFault("waypoint", "points", 10**6, "f8", AT, 0),
    ],
)
def test_where_there_is_no_such_word_nothing_is_injected(fault):
    flight = fly(mission(), fault)
    assert flight.log.digest() == golden().log.digest()
    assert [injection.activated for injection in flight.log.injections] == [False]


def test_what_was_published_is_not_changed_with_what_a_kernel_keeps_of_it():
    loop, twin = struck(MemoryFault("pid", "waypoint.x", None, "f8", AT, 62))
    assert loop.kernels["pid"].memory.waypoint.header["x"][0] != twin.kernels["pid"].memory.waypoint.header["x"][0]
    assert "waypoint" not in differing(loop, twin) and "planner" not in differing(loop, twin)


def test_everything_that_kernels_remember_has_words():
    known = {words.name.split(".")[0].split("[")[0] for name in golden().pipeline for words in _words(name)}
    for kernel in golden().pipeline.values():
        for name in kernel.memory.__slots__:
            value = getattr(kernel.memory, name)
            empty = value is None or (isinstance(value, (list, dict)) and not value)
            assert empty or name in known or name.startswith("marked")


def _words(name):
    return words_of(golden().pipeline[name])


@pytest.mark.parametrize("name", KERNELS_FLOWN)
def test_every_word_of_a_flight_can_be_struck_and_put_back(name):
    kernel = golden().pipeline[name]
    before = kernel.fingerprint()
    for words in list(words_of(kernel)):
        for index in {0, words.count - 1} if words.count else ():
            bit = strata.WORD_BITS[words.dtype] - 1
            changed, back = (change(kernel, words.name, index, ValueChange(Operation(bit=bit))) for _ in range(2))
            assert changed[0] != changed[1] or changed[0] == 0.0
            assert back[1] == changed[0] or np.isnan(changed[0])
    assert kernel.fingerprint() == before


@pytest.mark.parametrize(("policy", "status"), [("fresh", MissionStatus.SUCCESS), ("end", MissionStatus.NODE_DIED)])
def test_a_kernel_that_raises_dies_with_its_node(monkeypatch, policy, status):
    def watch(kernel, time_us):
        if kernel.memory.now.epoch >= 1 << 20:
            raise ZeroDivisionError("of such a number")

    monkeypatch.setattr(SetpointGenerator, "_check_deviation", watch)
    log = fly(mission(dead_node=policy), MemoryFault("waypoint", "now.epoch", None, "i4", AT, 20)).log
    assert (log.kernel.effect, log.kernel.detail) == ("exception", "ZeroDivisionError: of such a number")
    assert log.status is status


def test_a_fault_of_another_type_than_the_word_is_refused():
    fault = MemoryFault("planner", "decisions.acted_seq", None, "f8", AT, 60)
    with pytest.raises(BadInputError, match="dtype 'f8'; allowed: i4"):
        fly(mission(), fault)


# ---- detectors --------------------------------------------------------------------------------------
WATCHED = {
    "acceptance": ("acceptance", "paper"),
    "gaussian": ("gaussian", "paper"),
    "autoencoder": ("autoencoder", "paper"),
    "physics_gate": ("gaussian", "tuned"),
}
"""A detector with each part, and its profile."""
LAST_COMMAND = MemoryFault("acceptance", "last_command.vx", None, "f8", AT, 62)


def detector(name, profile="paper"):
    return detector_for(mission(), name, profile)[0]


def content(part):
    return {name: array.tobytes() for name, array in part.arrays().items()}


@pytest.mark.parametrize("name", WATCHING)
def test_everything_that_a_detector_remembers_has_words_that_can_be_changed(name):
    watching = detector(*WATCHED.get(name, (name, "paper")))
    fly(mission(), None, watching)
    part = part_of(watching, name)
    holder, kept = ArrayMemory(part), part.memory()
    every = list(words_of(holder))
    assert {words.dtype for words in every} <= set(strata.WORD_BITS) and len(every) >= 2
    for words in every:
        for index in {0, words.count - 1} if words.count else ():
            flip = ValueChange(Operation(bit=strata.WORD_BITS[words.dtype] - 1))
            before = content(part)
            assert change(holder, words.name, index, flip) is not None
            after = content(part)
            changed = [word for word in before if before[word] != after.get(word)]
            whole = [word for word in changed if not word.startswith("trajectories") or words.name == word]
            assert whole == [words.name], "a corrupted length changes what counts as stored, too"
            change(holder, words.name, index, flip)
    assert content(part) == before
    assert repr(part.memory()) == repr(kept)
    assert content(pickle.loads(pickle.dumps(part))) == content(part)


def test_a_published_message_is_not_changed_with_what_a_detector_remembers_of_it():
    watching = detector("acceptance")
    odometry = new_state("sensor.odometry")
    watching.start()
    watching.accept(odometry, 0)
    change(ArrayMemory(watching), "vehicle", 0, ValueChange(Operation(bit=62)))
    assert odometry.header["x"][0] == 0.0 != watching.odometry["x"][0]


def test_a_fault_in_a_detector_is_recorded_and_gone_in_the_next_flight():
    watching = detector("acceptance")
    recovery = RecoveryPolicy(grain="message")
    clean = fly(mission(), None, watching, recovery=recovery).log
    log = fly(mission(), LAST_COMMAND, watching, recovery=recovery).log
    (injection,) = log.injections
    assert (injection.level, injection.site) == ("memory", "memory:acceptance.last_command.vx")
    assert injection.activated and injection.time_s == 4.0
    assert [alarm.state for alarm in log.alarms] == ["control.command"], "it compares with what it remembers"
    assert log.status is MissionStatus.SUCCESS and clean.alarms == []
    assert fly(mission(), None, watching, recovery=recovery).log.digest() == clean.digest()
    assert fly(mission(), LAST_COMMAND).log.injections[0].activated is False, "there is no detector"


def test_a_detector_that_raises_dies_and_comes_back_without_the_fault():
    watching = detector("acceptance")
    part, spoilt, calls = part_of(watching, "acceptance"), [], []
    judge = part._check_functions["control.command"]

    def raising(state, now):
        calls.append(state)
        if part.record[0]["changes"] > 1 << 20:
            spoilt.append(state)
            raise IndexError("of such a number")
        return judge(state, now)

    part._check_functions["control.command"] = raising
    log = fly(mission(), MemoryFault("acceptance", "changes", None, "i8", AT, 40), watching).log
    assert (log.kernel.effect, log.kernel.detail) == ("exception", "IndexError: of such a number")
    assert len(spoilt) == 1 and log.status is MissionStatus.SUCCESS
    missed = round(0.57 / 0.02)
    flown = round(log.column("time")[-1] / 0.02)
    assert flown - missed - 3 <= len(calls) <= flown - missed + 3, "it returns after its restart"
    assert not {"check", "accept"} & set(vars(part))


def test_faults_in_detectors_are_drawn_from_flights_with_them():
    watching = detector("acceptance")
    fault, flown = MemoryRequest("acceptance", "last_command", None, AT).draw(ArmSetup(mission(), lambda: watching), 3)
    assert fault.kernel == "acceptance" and fault.field.startswith("last_command.") and fault.time_us == AT
    assert flown is None, "no golden flight without the detector was flown"
    drawn_from = fly_exposed(ArmSetup(mission(), lambda: watching), [])
    assert drawn_from.log.digest() == fly(mission(), None, detector("acceptance")).log.digest()
    with pytest.raises(BadInputError, match=r"memory:acceptance.nothing: no such word.*allowed: .*last_command.vx"):
        MemoryRequest("acceptance", "nothing").draw(ArmSetup(mission(), lambda: watching), 3)
    gated = r"autoencoder \(profile tuned\), gaussian \(profile tuned\)"
    for target, allowed in (("gaussian", "gaussian"), ("physics_gate", gated)):
        with pytest.raises(BadInputError, match=f"{target}.*is not part of this mission; allowed: with {allowed}"):
            MemoryRequest(target).draw(ArmSetup(mission(), lambda: watching), 3)
