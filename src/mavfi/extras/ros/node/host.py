"""The host `node`: a foreign ROS node under test.  A run is a trial: start the node, send inputs, compare its outputs.

A mission consists of error-free trials whose outputs must agree, followed by trials with a fault.  The instant of an
injection depends on the machine, not on the seed, so a trial is not bit-reproducible; `masked` means that all outputs
equal the golden ones.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, cast

from mavfi.errors import BadInputError
from mavfi.extras.ros.node.bench import NodeTrial, run_trial
from mavfi.extras.ros.node.config import NodeConfig
from mavfi.extras.ros.processes import private_network
from mavfi.extras.ros.ros1 import finder
from mavfi.faults.fault import Fault, RegisterFault
from mavfi.flight.host import ArmSetup, Host, Recorded, RunResult, one_by_one
from mavfi.mission import MissionSpec
from mavfi.outcomes import DUE, Effect
from mavfi.plugins import require_allowed
from mavfi.record import End, FlightRecord, Injection, KernelEffect

_DIED = tuple(effect.label for effect in DUE)


class NodeHost(Host):
    """Trials on a foreign node under test."""

    name = "node"
    levels = frozenset({"register"})
    deterministic = False
    flies = False
    config = NodeConfig
    config_key = "node"

    def __init__(self, node: NodeConfig | None = None) -> None:
        if node is None:
            raise BadInputError("host node: allowed: with the key node, which says what is under test")
        self._node = node

    @classmethod
    def campaign_defaults(cls, under_test: NodeConfig) -> dict[str, Any]:
        """See `Host.campaign_defaults`: one mission, in the place of the node."""
        return {"environments": [under_test.name.strip("/")], "missions": 1}

    def resolve(self, spec: MissionSpec) -> NodeConfig:
        """The node's configuration, in place of a scenario."""
        return self._node

    def mission(self, arms: Mapping[str, ArmSetup], *, fast_forward: bool = True) -> "NodeMission":
        """The trials of a mission; there is a single arm, and no fast-forward."""
        require_allowed("key 'node.command'", self._node.command[0])
        return NodeMission(self._node)

    def check(self) -> None:
        """See `Host.check`; includes the golden trials, see `golden_trial`."""
        require_allowed("key 'node.command'", self._node.command[0])
        finder.require()
        private_network()
        golden_trial(self._node)


class NodeMission:
    """The trials of one mission."""

    def __init__(self, node: NodeConfig) -> None:
        self._node = node
        self._outputs: tuple[str, ...] = ()

    def golden(self, arm: str, *, profile: bool = False) -> RunResult:
        """The error-free trials; see `golden_trial`."""
        trial = golden_trial(self._node)
        self._outputs = tuple(trial.outputs)
        return RunResult(record_of_trial(trial))

    def register_golden(self, arm: str, flight: Recorded) -> None:
        """See `MissionFlights.register_golden`; no operation, as no trial is run elsewhere."""

    def injected(self, runs: Sequence[tuple[str, Fault]]) -> Iterator[tuple[int, Recorded | Exception]]:
        """See `one_by_one`."""

        def run(_: str, fault: Fault) -> RunResult:
            return RunResult(record_of_trial(run_trial(self._node, self._outputs, cast(RegisterFault, fault))))

        return one_by_one(runs, run)


def golden_trial(node: NodeConfig) -> NodeTrial:
    """Run the error-free trials; returns the last one.

    Raises:
        BadInputError: Their outputs differ.
        MavfiError: The node does not start, or publishes no output.
    """
    trials = [run_trial(node) for _ in range(node.golden_runs)]
    if len({tuple(trial.outputs) for trial in trials}) > 1:
        raise BadInputError(
            f"node {node.name}: the outputs on {node.outputs.topic} of {node.golden_runs} golden trials differ, so "
            "nothing follows from them; name what changes by itself in node.outputs.ignore"
        )
    return trials[-1]


def record_of_trial(trial: NodeTrial) -> FlightRecord:
    """The record of a trial; its digest is that of its outputs, so that golden outputs count as masked."""
    extra = {
        "outputs": trial.outputs,
        "asked": trial.inputs_sent,
        "differing": len(trial.differing),
        "differences": trial.differences,
        "reason": trial.reason,
    }
    injections: tuple[Injection, ...] = ()
    if trial.injection is not None:
        injections = (Injection.from_json(trial.injection),)
    if trial.effect == Effect.UNKNOWN.label:
        return FlightRecord(End.UNKNOWN, injections=injections, extra=extra, error=trial.reason)
    if trial.effect in _DIED:
        kernel = KernelEffect(trial.effect, trial.reason)
        return FlightRecord(End.DUE, injections=injections, kernel=kernel, extra=extra, error=trial.reason)
    digest = hashlib.sha256(json.dumps([trial.outputs, trial.differing]).encode()).hexdigest()
    return FlightRecord(End.FLOWN, digest=digest, injections=injections, extra=extra)
