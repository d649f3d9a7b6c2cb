"""The host `airsim_program`: a client program of AirSim under test.  Each run executes the program once.

A mission consists of error-free runs, which must be the same, followed by runs with one fault at the boundary of the
program's calls.  Simulated time passes in calls only, so a run is a function of program, seed and fault.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

from mavfi.errors import BadInputError, SpecMismatchError
from mavfi.extras.airsim.boundary import Boundary
from mavfi.extras.airsim.config import ProgramConfig
from mavfi.extras.airsim.program import Ended, client_version, run_program
from mavfi.extras.airsim.server import msgpack
from mavfi.faults.fault import Fault, MessageFault
from mavfi.faults.levels.sensor.fault import SensorFault
from mavfi.flight.host import ArmSetup, Host, Recorded, RunResult, one_by_one
from mavfi.mission import MissionSpec
from mavfi.outcomes import Effect
from mavfi.plugins import require_allowed
from mavfi.record import End, FlightRecord, KernelEffect


@dataclass(frozen=True, slots=True)
class ProgramMission:
    """A program and the mission that its vehicle flies in, in place of a `Scenario`."""

    program: ProgramConfig
    spec: MissionSpec

    def to_json(self) -> dict[str, Any]:
        """Plain data, with a digest of the program's text."""
        return {"program": self.program.to_json(), "mission": self.spec.model_dump(mode="json")}

    def key(self) -> str:
        """Identifying hash."""
        return hashlib.sha256(json.dumps(self.to_json(), sort_keys=True).encode()).hexdigest()


class AirsimProgramHost(Host):
    """Runs of a client program."""

    name = "airsim_program"
    levels = frozenset({"message", "sensor"})
    flies = False
    config = ProgramConfig
    config_key = "program"

    def __init__(self, program: ProgramConfig | None = None) -> None:
        if program is None:
            raise BadInputError("host airsim_program: allowed: with the key program, the program under test")
        self._program = program

    def resolve(self, spec: MissionSpec) -> ProgramMission:
        """Program and mission, in place of a scenario."""
        return ProgramMission(self._program, spec)

    def check_stored(self, scenario: Mapping[str, Any]) -> None:
        """See `Host.check_stored`."""
        if self._program.to_json()["sha256"] != scenario["program"]["sha256"]:
            script = self._program.script
            raise SpecMismatchError(f"{script}: is absent, or another program than that of the campaign")

    def mission(self, arms: Mapping[str, ArmSetup], *, fast_forward: bool = True) -> "ProgramRuns":
        """The runs of a mission, without fast-forward: a program cannot be rewound."""
        require_allowed("key 'program.script'", self._program.script)
        return ProgramRuns({name: cast(ProgramMission, setup.scenario) for name, setup in arms.items()})

    def check(self) -> None:
        """See `Host.check`: package, program and client library exist."""
        require_allowed("key 'program.script'", self._program.script)
        msgpack()
        self._program.check()
        client_version(self._program.python, self._program.script)


class ProgramRuns:
    """The runs of one mission."""

    def __init__(self, missions: Mapping[str, ProgramMission]) -> None:
        self._missions = missions
        self._golden: dict[str, Ended] = {}

    def golden(self, arm: str, *, profile: bool = False) -> RunResult:
        """The error-free runs.

        Raises:
            BadInputError: They differ, because the program depends on wall-clock time or on unseeded randomness, or
                hang.
        """
        mission = self._missions[arm]
        runs = [
            run_program(mission.program, mission.spec, Boundary(keeps=True)) for _ in range(mission.program.golden_runs)
        ]
        if len({run.digest for run in runs}) > 1:
            raise BadInputError(
                f"{mission.program.script}: {len(runs)} error-free runs differ; allowed: programs whose randomness is "
                "seeded, and that measure time with the module time only"
            )
        if runs[0].how == "hang":
            raise BadInputError(f"{mission.program.script}: {runs[0].reason} without a fault; allowed: a larger wall_s")
        self._golden[arm] = runs[0]
        return RunResult(record_of_program(runs[0], runs[0]), tuple(runs[0].boundary.passed))

    def know(self, arm: str, flight: Recorded) -> None:
        """See `MissionFlights.know`; no operation, as no program is run elsewhere."""

    def injected(self, runs: Sequence[tuple[str, Fault]]) -> Iterator[tuple[int, Recorded | Exception]]:
        """See `one_by_one`."""

        def run(arm: str, fault: Fault) -> RunResult:
            mission, boundary = self._missions[arm], Boundary.of(cast(MessageFault | SensorFault, fault))
            ended = run_program(mission.program, mission.spec, boundary)
            return RunResult(record_of_program(ended, ended if ended.how == "ended" else self._golden_run(arm)))

        return one_by_one(runs, run)

    def _golden_run(self, arm: str) -> Ended:
        """The error-free run, which is run now if it was not before: a replay begins with a fault."""
        if arm not in self._golden:
            self.golden(arm)
        return self._golden[arm]


def record_of_program(ended: Ended, golden: Ended) -> FlightRecord:
    """The record of a run.

    A program that still runs when its time is up hangs, if the error-free one (`golden`) ended.  An exit code other
    than 0 is a crash, if it is not that of the error-free one.
    """
    injection = ended.boundary.injected
    injections = () if injection is None else (injection,)
    extra = {"how": ended.how, "calls": sum(ended.calls.values()), "refused": sum(ended.errors.values())}
    effects = {"program crash": Effect.EXCEPTION, "hang": Effect.HANG}
    if golden.how == "ended":
        effects["time is up"] = Effect.HANG
    effect = None if ended.ends_like(golden) else effects.get(ended.how)
    if effect is not None:
        reason = ended.reason or "its time is up"
        return FlightRecord(
            End.DUE, injections=injections, kernel=KernelEffect(effect.label, reason), extra=extra, error=reason
        )
    return FlightRecord(End.FLOWN, ended.status.label, ended.digest, ended.seconds, injections=injections, extra=extra)
