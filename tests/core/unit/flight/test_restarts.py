"""What becomes of a node that dies: which policy sends it what, and when."""

from types import SimpleNamespace

import numpy as np
import pytest

from mavfi.config import PlatformConfig
from mavfi.flight.loop import HANDLERS, Latencies, Loop
from mavfi.flight.restarts import Restarts
from mavfi.flight.state import EventKind, FlightState
from mavfi.flight.taps import Taps
from mavfi.mission import MissionStatus
from mavfi.states import KERNELS, new_state

SECOND = 1_000_000
OUTPUT = new_state("planning.path")


class Kernel:
    """Notes what it is sent; a planner by what it reads."""

    reads = ("perception.map_update", "perception.collision_status", "planning.waypoint", "planning.trajectory")

    def __init__(self, name):
        self.name, self.stage = name, KERNELS[name].stage
        self.received, self.resumed, self.marks = [], None, 0

    def receive(self, state, time_us):
        self.received.append(state)
        return state.spec.name == "perception.map_update"

    def resume(self, last, time_us):
        self.resumed = dict(last)
        return ("planning.waypoint",)

    def mark(self):
        self.marks += 1


class ToyLoop(Loop):
    """What `Restarts` uses of a loop."""

    def __init__(self):
        self.taps, self.state = Taps(), FlightState(np.zeros(3))
        self.state.awaited = {"planning.path": 1, "control.command": 2}
        self.kernels = self.renew("planner")
        self.latencies = Latencies(PlatformConfig(name="toy", latency_us={"planner": 80_000, "trajectory": 0}))
        self.readers = {"planning.waypoint": [self.kernels["planner"]]}
        self.marks, self.started, self.finished = False, [], []
        self.record = SimpleNamespace(recompute_us={"planning": 0})

    @staticmethod
    def renew(kernel):
        return {name: Kernel(name) for name in ("planner", "trajectory")}

    def start(self, kernel, now):
        self.started.append((kernel.name, now))

    def finish(self, kernel, states, now, latency_us):
        self.finished.append((kernel.name, states, now, latency_us))
        if latency_us:
            self.state.busy[kernel.name] = None

    def run(self):
        """Handle the only event."""
        ((time_us, _, kind, arguments),) = self.state.queue
        self.state.queue.clear()
        HANDLERS[kind](self, time_us, *arguments)
        return self.kernels["planner"]


def collision(seq, flag):
    state = new_state("perception.collision_status")
    state.header["future_collision_seq"], state.header["collision"] = seq, flag
    return state


def in_force(epoch):
    state = new_state("planning.waypoint")
    state.header["future_collision_seq"] = epoch
    return state


def dead(policy, *published):
    """A loop in which the planner has died after some publications."""
    loop = ToyLoop()
    restarts = Restarts(loop, policy)
    for state in published:
        loop.taps(state, 0)
    restarts.die("planner", 400_000, 600_000)
    loop.kept_alive = restarts
    return loop


ALARM, QUIET = collision(1, True), collision(1, False)
UPDATES = [new_state("perception.map_update") for _ in range(3)]
TRAJECTORY = new_state("planning.trajectory")


@pytest.mark.parametrize(
    ("policy", "epoch", "sent"),
    [
        ("fresh", 0, [QUIET]),
        ("readback", 0, [ALARM, QUIET]),
        ("readback", 1, [QUIET]),
    ],
)
def test_what_a_restarted_node_is_sent(policy, epoch, sent):
    waypoint = in_force(epoch)
    loop = dead(policy, *UPDATES, ALARM, TRAJECTORY, QUIET, in_force(0), waypoint)
    flight = loop.state
    assert flight.down == set(flight.busy) == {"planner", "trajectory"} and list(flight.awaited) == ["control.command"]
    before = loop.kernels["planner"]
    kernel = loop.run()
    assert kernel is not before and loop.readers["planning.waypoint"] == [kernel]
    back = policy == "readback"
    assert kernel.received == [*UPDATES, *sent, *([] if back else [waypoint])], "nothing that passed within the node"
    assert (kernel.resumed is not None) == back
    assert not flight.down and loop.started == [("planner", SECOND), ("trajectory", SECOND)] and kernel.marks == 0
    if back:
        assert kernel.resumed["planning.trajectory"] is TRAJECTORY
        assert kernel.resumed["perception.collision_status"] is QUIET


def test_recoveries_do_not_take_back_what_a_node_was_sent():
    loop = dead("fresh", *UPDATES)
    loop.marks = True
    assert loop.run().marks == 1


def test_the_mission_ends():
    loop = dead("end")
    assert loop.status is MissionStatus.NODE_DIED and not loop.state.queue


@pytest.mark.parametrize("waiting", [None, QUIET])
def test_a_detected_step_is_computed_again_at_once(waiting):
    loop = ToyLoop()
    loop.repeat_step("planner", 400_000, [OUTPUT])
    assert loop.state.queue == [(480_000, 1, EventKind.REPETITION_DONE, ("planner", [OUTPUT]))]
    assert loop.state.down == {"planner"} and loop.record.recompute_us == {"planning": 80_000}
    before = loop.kernels["planner"]
    loop.state.busy["planner"] = waiting
    assert loop.run() is before
    assert loop.finished == [("planner", [OUTPUT], 480_000, 80_000)]
    assert not loop.state.down and loop.state.busy == {"planner": waiting}


@pytest.mark.parametrize("policy", ["fresh", "readback"])
def test_a_node_that_is_away_does_not_die_again(policy):
    loop = ToyLoop()
    restarts = Restarts(loop, policy)
    restarts.die("planner", 0, SECOND)
    queued = list(loop.state.queue)
    Restarts(loop, "readback").die("planner", SECOND // 2, 20_000)  # a detector that waits for its answer
    assert len(queued) == 1 and loop.state.queue == queued
