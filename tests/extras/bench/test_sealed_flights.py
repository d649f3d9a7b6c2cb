"""Checksum and oracle, and steps computed twice: in whole flights."""

import pytest

from mavfi.extras.bench.sealed import Checksum, Duplicate, Oracle
from mavfi.flight.compose import new_loop, watch
from mavfi.flight.decide import RecoveryPolicy
from mavfi.flight.fly import fly
from mavfi.levels.state.fault import StateFault
from mavfi.states import KERNELS
from tests.core.flights.instruction.test_detectors import faults, scenario  # noqa: F401 - a fixture
from tests.core.flights.missions import fault, golden, mission

RESEND = RecoveryPolicy(grain="message")
STRUCK = [
    ("perception.collision_status", "collision", 0),
    ("planning.waypoint", "x", 62),
    ("planning.trajectory", "vx", 62),
    ("control.command", "vy", 62),
]


def site(state, field, bit) -> StateFault:
    times = golden().profile.times_us[state]
    return fault(state, field, 1e-6 * times[len(times) // 2], bit, element=0)


@pytest.mark.parametrize(("state", "field", "bit"), STRUCK)
def test_a_message_that_is_sent_again_leaves_the_golden_flight(state, field, bit):
    struck = fly(mission(), site(state, field, bit), Checksum(), recovery=RESEND).log
    assert struck.injections[0].activated
    assert [(alarm.state, alarm.action, alarm.outcome) for alarm in struck.alarms] == [(state, "resend", "repaired")]
    assert struck.digest() == golden().log.digest()
    assert sum(struck.meta["recompute_us"].values()) == 0


@pytest.mark.parametrize("make", [Checksum, lambda: Checksum(large=True), Oracle])
def test_a_golden_flight_raises_no_alarm(make):
    log = fly(mission(), detector=make(), recovery=RESEND).log
    assert log.alarms == [] and log.digest() == golden().log.digest()


# ---- steps computed twice -------------------------------------------------------------------------------------------
KERNELS_HERE = tuple(name for name, spec in KERNELS.items() if not spec.only_with)


def without_latency(detector, **changes):
    """A flight of which latencies are not charged again, so that it can be compared with one without a detector."""
    loop = new_loop(mission(**changes))
    watch(loop, detector)
    verify = loop.verify
    loop.verify = lambda kernel, states, now: (verify(kernel, states, now)[0], 0)
    return loop.fly().log


@pytest.mark.parametrize("autopilot", ["published", "hardened"])
def test_a_second_run_of_every_kernel_gives_the_same(autopilot):
    log = without_latency(Duplicate(KERNELS_HERE), autopilot=autopilot)
    assert log.alarms == [] and log.digest() == golden(autopilot).log.digest()


class Wrong:
    """Changes the results of chosen runs of a kernel, as a fault in its computation does."""

    def __init__(self, loop, kernel, runs):
        self.loop, self.runs, self.count = loop, runs, 0
        self.kernel = loop.kernels[kernel]
        self.step, self.kernel.step = self.kernel.step, self

    def __call__(self, now):
        states = self.step(now)
        if self.count in self.runs:
            states[0] = states[0].copy()
            states[0].header["vx"] += self.runs[self.count]
        self.count += 1
        return states


@pytest.mark.parametrize(
    ("runs", "outcome"), [({40: 1.0}, "repaired"), ({41: 1.0}, "accepted"), ({40: 1.0, 41: 2.0}, "rejected")]
)
def test_two_of_three_decide(runs, outcome):
    loop = new_loop(mission())
    watch(loop, Duplicate(["pid"]))
    verify = loop.verify
    loop.verify = lambda kernel, states, now: (verify(kernel, states, now)[0], 0)
    wrong = Wrong(loop, "pid", runs)
    log = loop.fly().log
    (alarm,) = log.alarms
    assert (alarm.source, alarm.state, alarm.outcome) == ("duplicate", "control.command", outcome)
    assert log.digest() == golden().log.digest() and wrong.count > 100
