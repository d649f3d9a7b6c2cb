"""Which flights of a mission are fast-forwarded, and what becomes of those that cannot be flown."""

from contextlib import contextmanager
from types import MappingProxyType, SimpleNamespace

import pytest

from mavfi.detectors.detector import NoDetector
from mavfi.errors import BadInputError
from mavfi.faults.fault import FaultSite, InstructionFault, RegisterFault, StateFault
from mavfi.flight import mission_flights
from mavfi.flight.decide import INLINE, RecoveryPolicy
from mavfi.flight.forks import InjectedRuns
from mavfi.flight.host import ArmSetup, Flight
from mavfi.flight.mission_flights import LocalHost
from mavfi.record import Profile

SITE = FaultSite("control.command", "vx")
FAULT, NULL = StateFault(SITE, 5, 62), StateFault(SITE, 5)
DATA, WRONG = InstructionFault("f", "sha", 1), InstructionFault("f", "wrong", 1)


def check(faults):
    if WRONG in faults:
        raise BadInputError("other machine code")


WATCHER = NoDetector()


class Scenario(SimpleNamespace):
    flight_controller, protection, kernels = "cascade", None, MappingProxyType({})
    planner, map = SimpleNamespace(name="rrt_connect"), SimpleNamespace(kind="dense")

    def key(self):
        return self.name


@pytest.fixture
def calls(monkeypatch):
    """What was flown, and how; `broken` lets flights fail, with `follow` runs with a detector are known."""
    found = SimpleNamespace(flown=[], made=[], detectors=0, broken=False, follow=False, copied=True)

    class FastForward:
        def __init__(self, scenario, *, scratch):
            found.made.append(scenario.name + " with scratch" * scratch)
            self.scratch = scratch and scenario.name != "octree"
            self.supported = scenario.name != "planner"

        @contextmanager
        def instrumented(self, functions, listeners):
            found.made.append(f"counts {', '.join(functions)}")
            yield

        def resolve(self, functions):
            found.made.append(f"resolves {', '.join(functions)}")

        def fly(self, fault=None, detector=None, arm="", recovery=INLINE):
            if found.broken:
                raise ZeroDivisionError
            found.flown.append(("fast", fault, detector, arm, recovery))
            return SimpleNamespace(log=fault, profile=Profile())

    def fly(scenario, fault, detector, *, recovery, profile=False, **_):
        found.flown.append(("long", fault, detector, scenario.name, recovery))
        return Flight(fault, Profile() if profile else None)

    def fly_instruction_faults(scenario, faults, detector, golden, recovery):
        check(faults)
        found.flown.append(("instructions", tuple(faults), detector, golden, recovery))
        return InjectedRuns(golden, [Flight(fault) for fault in faults])

    def fly_from_checkpoints(forward, faults, golden, arm, watched):
        check(faults)
        found.flown.append(("checkpoints", tuple(faults), arm.detector, arm.name, arm.recovery))
        follow = {other.name: {0: Flight(f"{other.name} after plain")} for other in watched if found.follow}
        return InjectedRuns(golden, [Flight(fault) for fault in faults], follow)

    monkeypatch.setattr(mission_flights, "FastForward", FastForward)
    monkeypatch.setattr(mission_flights, "can_save_detector", lambda detector: detector is None or found.copied)
    monkeypatch.setattr(mission_flights, "fly_from_checkpoints", fly_from_checkpoints)
    monkeypatch.setattr(mission_flights, "fly", fly)
    monkeypatch.setattr(mission_flights, "fly_instruction_faults", fly_instruction_faults)
    return found


@pytest.fixture
def arms(calls):
    def make():
        calls.detectors += 1
        return WATCHER

    return {
        "": ArmSetup(Scenario(name="own")),
        "g": ArmSetup(Scenario(name="own"), make, RecoveryPolicy("observer")),
        "slow": ArmSetup(Scenario(name="other")),
    }


def ways(calls):
    return [(way, fault) for way, fault, *_ in calls.flown]


def test_flights_of_a_mission_share_what_is_known_of_their_scenario(calls, arms):
    flights = LocalHost().mission(arms)
    assert flights.golden("", profile=True).profile is not None
    for _, flight in flights.injected([("", FAULT), ("g", FAULT), ("slow", FAULT)]):
        assert flight.log is FAULT
    flights.golden("g")
    assert [way for way, *_ in calls.flown] == ["fast"] * 5
    assert calls.made == ["own", "other"]
    assert calls.flown[2] == ("fast", FAULT, WATCHER, "g", RecoveryPolicy("observer")), (
        "known flights are distinguished by arm"
    )
    assert calls.flown[3][3] == "", "without a detector it is the scenario alone that counts"
    assert calls.detectors == 1


def test_null_runs_and_those_who_do_not_want_it_are_flown_the_long_way(calls, arms):
    list(LocalHost().mission(arms).injected([("", NULL), ("", FAULT)]))
    list(LocalHost().mission(arms, fast_forward=False).injected([("", FAULT)]))
    assert ways(calls) == [("long", NULL), ("fast", FAULT), ("long", FAULT)]


@pytest.mark.parametrize("why", ["controller", "planner", "detector", "plant"])
def test_what_no_checkpoint_can_contain_is_flown_from_take_off(calls, arms, why):
    host, arm = LocalHost(), "g" if why == "detector" else ""
    if why == "controller":
        arms[""].scenario.flight_controller = "betaflight"
    if why == "planner":
        arms[""].scenario.name = "planner"
    if why == "plant":
        host = LocalHost(lambda world, scenario: None)
    calls.copied = why != "detector"
    flights = host.mission(arms)
    list(flights.injected([(arm, FAULT)]))
    assert ways(calls) == [("long", FAULT)]
    if why == "detector":
        list(flights.injected([("", FAULT)]))
        assert ways(calls)[1:] == [("fast", FAULT)], "flights without it are fast-forwarded"


def test_an_exception_ends_its_own_run_and_the_next_one_starts_afresh(calls, arms):
    flights = LocalHost().mission(arms)
    flights.golden("")
    calls.broken = True
    [(_, error)] = flights.injected([("", FAULT)])
    assert isinstance(error, ZeroDivisionError)
    calls.broken = False
    list(flights.injected([("", FAULT)]))
    assert ways(calls) == [("fast", None), ("fast", FAULT)]
    assert calls.made == ["own", "own"], "one that failed is not kept"


def test_the_golden_flight_that_takes_the_checkpoints_counts_and_resolves_instructions(calls, arms):
    flights = LocalHost().mission(arms)
    golden = flights.count_instructions("", {"track": None})
    assert flights.golden("") is golden
    flights.resolve_instructions("", {"track": None})
    assert calls.made == ["own with scratch", "counts track", "resolves track"]
    flights.count_instructions("", {"track": abs})
    assert [way for way, *_ in calls.flown] == ["fast", "long"], "the checkpoints have been taken"


def test_instruction_faults_are_flown_arm_by_arm_and_keep_their_places(calls, arms):
    flights = LocalHost().mission(arms)
    flights.count_instructions("", {})
    other = InstructionFault("f", "sha", 2)
    found = dict(flights.injected([("", DATA), ("g", DATA), ("", other), ("g", FAULT)]))
    assert {place: flight.log for place, flight in found.items()} == {0: DATA, 1: DATA, 2: other, 3: FAULT}
    assert calls.flown == [
        ("fast", None, None, "", INLINE),
        ("fast", FAULT, WATCHER, "g", RecoveryPolicy("observer")),
        ("checkpoints", (DATA, other), None, "", INLINE),
        ("instructions", (DATA,), WATCHER, None, RecoveryPolicy("observer")),
    ], "without a golden flight of its own an arm flies from take-off"
    assert calls.made == ["own with scratch", "counts "]


def test_runs_with_a_detector_that_follow_from_those_without_are_not_flown(calls, arms):
    flights = LocalHost().mission(arms)
    flights.count_instructions("", {})
    flights.register_golden("g", Flight("golden of g"))
    calls.follow = True
    other = InstructionFault("f", "sha", 2)
    found = dict(flights.injected([("", DATA), ("g", DATA), ("", other), ("g", other)]))
    assert {place: flight.log for place, flight in found.items()} == {0: DATA, 1: "g after plain", 2: other, 3: other}
    assert [faults for way, faults, *_ in calls.flown if way == "checkpoints"] == [(DATA, other), (other,)]


@pytest.mark.parametrize("why", ["detector", "unknown", "no fast-forward", "restarts", "octree"])
def test_instruction_faults_are_flown_from_take_off_where_checkpoints_cannot_be_used(calls, arms, why):
    if why == "restarts":
        arms["g"] = ArmSetup(Scenario(name="own"), arms["g"].make_detector, RecoveryPolicy(answer_s=0.6))
    if why == "octree":
        arms["g"] = ArmSetup(Scenario(name="octree"), arms["g"].make_detector)
    flights = LocalHost().mission(arms, fast_forward=why != "no fast-forward")
    flights.count_instructions("", {})
    if why != "unknown":
        flights.register_golden("g", Flight("golden"))
    fault = InstructionFault("f", "sha", 1, kernel="acceptance") if why == "detector" else DATA
    [(_, flight)] = flights.injected([("g", fault)])
    assert flight.log is fault
    assert ways(calls)[1:] == [("instructions", (fault,))]


def test_a_fault_that_cannot_be_flown_ends_its_own_flight_only(calls, arms):
    flights = LocalHost().mission(arms)
    found = dict(flights.injected([("", DATA), ("", WRONG), ("", RegisterFault()), ("", DATA), ("", FAULT)]))
    assert {place for place, flight in found.items() if isinstance(flight, Exception)} == {1, 2}
    assert "other machine code" in str(found[1])
    assert "level 'register': allowed: combined, instruction, memory, message, sensor, state" in str(found[2])
