"""The host `airsim_program`: a client program of AirSim under test.  Each run executes the program once.

A mission consists of error-free runs, which must be the same, followed by runs with one fault at the boundary of the
program's calls.  Simulated time passes in calls only, so a run is a function of program, seed and fault.
"""

import asyncio
import hashlib
import json
import os
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

from mavfi.errors import BadInputError, SpecMismatchError, not_known
from mavfi.extras.airsim.boundary import Boundary
from mavfi.extras.airsim.config import IMAGE, VEHICLE, ProgramConfig, pixels
from mavfi.extras.airsim.level import CallLevel
from mavfi.extras.airsim.runner import EXIT_CRASH, EXIT_TIME_IS_UP
from mavfi.extras.airsim.server import HOST, AirsimServer, StepClock, msgpack
from mavfi.extras.airsim.settings import FIELD_OF_VIEW, AirsimSettings, CaptureSize, VehicleSettings, read_settings
from mavfi.extras.airsim.table import Api, ApiScene
from mavfi.faults.fault import Fault
from mavfi.flight.compose import resolve
from mavfi.flight.host import ArmSetup, Host, Recorded, RunResult, one_by_one
from mavfi.levels.message.fault import MessageFault
from mavfi.levels.sensor.fault import SensorFault
from mavfi.mission import MissionSpec, MissionStatus
from mavfi.outcomes import Effect
from mavfi.plugins import require_allowed
from mavfi.record import End, FlightRecord, Injection, KernelEffect
from mavfi.sim.scene import STEP_US

# ---- one run of a program --------------------------------------------------------------------------------------------
V_MAX = 12.0
"""Speed limit of the vehicle unless chosen (m/s): programs for AirSim choose their own speeds."""
_RUNNER = Path(__file__).with_name("runner.py")
_PATIENCE_S = 5.0
"""Longest wait for the last calls of a program that has ended, and for one that was killed (s)."""
_SILENT_SHARE = 0.5
"""Share of the longest wall-clock time of a program after whose last call it only keeps itself alive."""
_CHUNK = 4096
"""Bytes of the standard input that are passed at once; a pipe takes as many."""


def make_api(
    spec: MissionSpec,
    image: str = "",
    name: str = VEHICLE,
    version: int = 1,
    *,
    on_ground: bool = True,
    settings: str = "",
) -> Api:
    """The vehicles of a mission behind the API; the first of them.

    Args:
        spec: The mission.
        image: Size of images; "" = AirSim's default, or without a ground start that of the mission's camera.
        name: Of the vehicle.
        version: Of the API.
        on_ground: See `PilotedVehicle`.
        settings: Path of AirSim's settings.json; "" = none.

    Raises:
        BadInputError: The mission cannot be flown, or the settings ask for what does not exist here.
    """
    if on_ground and spec.v_max is None:
        spec = spec.model_copy(update={"v_max": V_MAX})
    if not image:
        image = IMAGE
        if not on_ground:
            camera = resolve(spec).camera
            image = f"{camera.width}x{camera.height}"
    capture = CaptureSize(*pixels(image), FIELD_OF_VIEW)
    airsim_settings = AirsimSettings()
    if settings:
        airsim_settings = read_settings(Path(settings), capture)

    # the vehicles of the settings, or one
    scene = ApiScene(capture, version, airsim_settings, paused=not on_ground, wind=airsim_settings.wind)
    for vehicle in airsim_settings.vehicles or (VehicleSettings(name),):
        try:
            scene.add(spec, vehicle, on_ground=on_ground)
        except BadInputError as error:
            if not settings:
                raise
            raise BadInputError(f"--settings: {settings}: Vehicles.{vehicle.name}: {error}") from None
    scene.name_objects()
    return scene.first


def check_fault_vehicle(scene: ApiScene, name: str) -> None:
    """Raise a `BadInputError` if there is no vehicle of this name, whose calls would be changed; "" = the first one."""
    if name and name not in scene.vehicles:
        raise BadInputError(f"--fault-vehicle: {not_known(name, scene.vehicles)}")


@dataclass(frozen=True, slots=True)
class ProgramResult:
    """A program that ran.

    Attributes:
        how: "ended", "time is up", "program crash" or "hang".
        code: Its exit code; None = it hangs.
        reason: Its exception, the last line that it wrote to stderr, its exit code, or what it waited for when its time
            was up; "" if it ended.
        collided: Whether its vehicle touched an obstacle.
        digest: Of the vehicle's states and of how the program ended.
        seconds: Simulated time (s).
        calls: Number of calls by name.
        errors: Number of refused calls by message.
        output: What it wrote to stdout.
        error_output: What it wrote to stderr.
        boundary: Calls, injection and alarms at the boundary.
    """

    how: str
    reason: str
    collided: bool
    digest: str
    seconds: float
    calls: dict[str, int]
    errors: dict[str, int]
    output: str
    boundary: Boundary = field(repr=False)
    code: int | None = 0
    error_output: str = ""

    def ends_like(self, other: "ProgramResult") -> bool:
        """Whether both ended in the same way, e.g. with the same exit code."""
        return (self.how, self.code) == (other.how, other.code)

    @property
    def is_sound(self) -> bool:
        """Whether it ended without an error, or would fly on, and no call was refused."""
        return self.how in ("ended", "time is up") and not self.errors

    @property
    def status(self) -> MissionStatus:
        """Status of the mission: a collision, otherwise a success, however the program ended."""
        if self.collided:
            return MissionStatus.COLLISION
        return MissionStatus.SUCCESS


def effect_on(golden: ProgramResult, injected: ProgramResult) -> str:
    """What a fault did to a program: masked, deviates, collision, program crash, hang, or not activated."""
    if injected.boundary.injected is None:
        return "not activated"
    if injected.how not in ("ended", "time is up") and not injected.ends_like(golden):
        return injected.how
    if injected.how == "time is up" and golden.how == "ended":
        return "hang"
    if injected.collided and not golden.collided:
        return "collision"
    if injected.digest == golden.digest:
        return "masked"
    return "deviates"


class ProgramInput:
    """The standard input of a program: each run reads the same bytes from the start.

    Args:
        source: File descriptor that they come from; None = there are none.
    """

    def __init__(self, source: int | None = None) -> None:
        self._source = source
        self._content = bytearray()

    def begin(self) -> None:
        """Pass the bytes to a new process, whose standard input is `reading_end`."""
        self.reading_end, self._writing_end = os.pipe()
        os.set_blocking(self._writing_end, False)
        self._sent = 0

    def pump(self) -> None:
        """Pass what the process takes and what has come, without waiting."""
        if self._writing_end < 0:
            return
        is_all_sent = self._sent == len(self._content)
        if is_all_sent and self._source is not None and select.select([self._source], [], [], 0.0)[0]:
            chunk = os.read(self._source, _CHUNK)
            self._content += chunk
            if not chunk:
                self._source = None
        try:
            if self._sent < len(self._content):
                self._sent += os.write(self._writing_end, self._content[self._sent : self._sent + _CHUNK])
            elif self._source is None:
                self.end()
        except BlockingIOError:
            pass  # the pipe is full
        except BrokenPipeError:
            self.end()

    def end(self) -> None:
        """Close the writing end."""
        if self._writing_end >= 0:
            os.close(self._writing_end)
        self._writing_end = -1


def run_program(
    program: ProgramConfig, spec: MissionSpec, boundary: Boundary, standard_input: ProgramInput | None = None
) -> ProgramResult:
    """Run a program to its end, with its own vehicle and port.

    Args:
        program: The program.
        spec: The mission.
        boundary: The boundary that its calls pass.
        standard_input: What it reads; None = nothing.

    Raises:
        BadInputError: There is no such program, Python, client library or world.
    """
    program.check()
    return asyncio.run(_Run(program, spec, boundary, standard_input or ProgramInput()).run())


class _Run:
    """One run of a program."""

    def __init__(
        self, program: ProgramConfig, spec: MissionSpec, boundary: Boundary, standard_input: ProgramInput
    ) -> None:
        self._program = program
        self._boundary = boundary
        self._input = standard_input
        version = program.version or client_version(program.python, program.script)
        boundary.vehicle = program.fault_vehicle
        self._api = make_api(spec, program.image, program.vehicle, version, settings=program.settings)
        self._clock = StepClock(program.call_us, round(1e6 * program.seconds / STEP_US) * STEP_US)
        self._server = AirsimServer(self._api, self._clock, boundary)
        self._process: subprocess.Popen[bytes] | None = None

    async def run(self) -> ProgramResult:
        """Serve the program until it ends."""
        with tempfile.TemporaryDirectory(prefix="mavfi-airsim-") as folder:
            output = Path(folder, "stdout")
            errors = Path(folder, "stderr")

            def start(port: int) -> None:
                self._input.begin()
                with output.open("wb") as out, errors.open("wb") as err:
                    self._process = subprocess.Popen(
                        [
                            self._program.python or sys.executable,
                            str(_RUNNER),
                            str(port),
                            self._program.script,
                            *self._program.arguments,
                        ],
                        stdin=self._input.reading_end,
                        stdout=out,
                        stderr=err,
                        env=_environment(),
                    )
                os.close(self._input.reading_end)

            # the program is started when the server is ready, and the server is stopped when the program has ended
            serving = asyncio.create_task(self._server.run(0, start))
            try:
                code = await self._wait(serving)
            finally:
                serving.cancel()
                await asyncio.wait({serving})
                self._input.end()
                if self._process is not None and self._process.poll() is None:
                    self._process.kill()
                    self._process.wait(_PATIENCE_S)
                self._api.scene.close()
            return self._result(code, output.read_text(errors="replace"), errors.read_text(errors="replace"))

    async def _wait(self, serving: "asyncio.Task[None]") -> int | None:
        """Exit code of the program; None = it hangs."""
        end = time.monotonic() + self._program.wall_s
        # Until the program ends, or its wall-clock time is over.
        while time.monotonic() < end:
            if serving.done():
                serving.result()  # raises what ended it
            code = None
            if self._process is not None:
                self._input.pump()
                code = self._process.poll()
            if code is not None:
                if self._server.calls:  # its last calls may not have been served yet
                    with suppress(TimeoutError):
                        await asyncio.wait_for(self._server.finished.wait(), _PATIENCE_S)
                return code
            await asyncio.sleep(0.01)
        # a program that keeps itself alive without a call is not slow: the rest of its flight is flown without it
        silent_s = time.monotonic() - self._server.last_call_s
        if self._server.last_call and silent_s > _SILENT_SHARE * self._program.wall_s:
            self._server.last_wait = (
                f"what is not simulated, or computed, since its call {self._server.last_call} ({silent_s:.0f} s of "
                "wall-clock time)"
            )
            self._clock.end(self._api.scene)
            return EXIT_TIME_IS_UP
        return None

    def _result(self, code: int | None, output: str, errors: str) -> ProgramResult:
        """How the program ended, by its exit code; None = it hangs."""
        scene = self._api.scene
        check_fault_vehicle(scene, self._program.fault_vehicle)
        reason = _exception_line(errors)
        # a program that crashes before its first call does not work at all: no fault has done that
        if not self._server.calls and code == EXIT_CRASH:
            raise BadInputError(f"{self._program.script}: made no call ({reason or 'without a message'})")

        # how it ended
        if code is None:
            how = "hang"
            reason = (
                f"still running after {self._program.wall_s:g} s of wall-clock time, at {1e-6 * scene.now_us:.3f} s of "
                f"--seconds {self._program.seconds:g}"
            )
        elif code == EXIT_TIME_IS_UP:
            how = "time is up"
            reason = f"it waited for {self._server.last_wait}; more time: --seconds above {self._program.seconds:g}"
        elif code == 0:
            how = "ended"
            reason = ""
        else:
            how = "program crash"
            reason = reason or f"exit code {code}"
        digest = hashlib.sha256(f"{scene.digest()} {how} {code}".encode()).hexdigest()
        return ProgramResult(
            how,
            reason,
            scene.has_ever_collided,
            digest,
            1e-6 * scene.now_us,
            dict(self._server.calls),
            dict(self._server.errors),
            output,
            self._boundary,
            code,
            errors,
        )


def _exception_line(errors: str) -> str:
    """The exception of the last traceback in what a program wrote to stderr; without one, the last line."""
    lines = [line for line in errors.splitlines() if line.strip()]
    if not lines:
        return ""
    start = max((index for index, line in enumerate(lines) if line.startswith("Traceback ")), default=len(lines))
    return next((line for line in lines[start + 1 :] if not line[0].isspace()), lines[-1])


def _environment() -> dict[str, str]:
    """Variables of the program: the user's; its output is not buffered, so that none is lost if it hangs."""
    return {**os.environ, "PYTHONHASHSEED": "0", "PYTHONUNBUFFERED": "1"}


_VERSION = """
import sys
sys.path[0] = sys.argv[1]
try:
    import airsim
    from airsim import VehicleClient
except ImportError:
    import cosysairsim as airsim
print(airsim.VehicleClient.getClientVersion(airsim.VehicleClient) if "cosys" not in airsim.__name__
      else airsim.VehicleClient.getClientVersion())
"""
"""Modules are looked for where the runner looks: in the program's folder first, never in the working directory."""
_VERSIONS: dict[tuple[str, str], int] = {}


def client_version(python: str, script: str) -> int:
    """Version of the API of the AirSim client that a program imports, which the server reports as its own.

    Args:
        python: Interpreter; "" = this one.
        script: File of the program.

    Raises:
        BadInputError: It has no such client.
    """
    folder = str(Path(script).absolute().parent)
    if (python, folder) not in _VERSIONS:
        program = python or sys.executable
        try:
            done = subprocess.run(
                [program, "-c", _VERSION, folder],
                capture_output=True,
                text=True,
                check=False,
                env=_environment(),
                stdin=subprocess.DEVNULL,
            )
        except OSError as error:
            raise BadInputError(f"--python: {program}: {error.strerror}; allowed: a Python interpreter") from None
        with suppress(ValueError):
            _VERSIONS[python, folder] = int(done.stdout)
        if (python, folder) not in _VERSIONS:
            last = (done.stderr.strip().splitlines() or ["no version"])[-1]
            raise BadInputError(
                f"--python: {program}: has no AirSim client ({last}); allowed: with the package airsim or cosysairsim"
            )
    return _VERSIONS[python, folder]


def world_address(text: str) -> tuple[str, int]:
    """Host and port of "airsim://127.0.0.1:41451".

    Raises:
        BadInputError: Another form, or not on loopback.
    """
    host, _, port = text.removeprefix("airsim://").partition(":")
    if text.startswith("airsim://") and host in (HOST, "localhost") and port.isdigit() and 0 < int(port) < 65536:
        return HOST, int(port)
    raise BadInputError(f"--world: {text!r}: allowed: airsim://127.0.0.1:PORT, on this machine")


def shown(result: ProgramResult) -> dict[str, Any]:
    """A run as plain data."""
    injection = None
    if result.boundary.injected is not None:
        injection = result.boundary.injected.to_json()
    alarms: list[dict[str, Any]] = []
    if result.boundary.watch is not None:
        alarms = [alarm.to_json() for alarm in result.boundary.watch.alarms]
    return {
        "how": result.how,
        "reason": result.reason,
        "collision": result.collided,
        "digest": result.digest,
        "seconds": round(result.seconds, 6),
        "calls": result.calls,
        "errors": result.errors,
        "injection": injection,
        "alarms": alarms,
        "output": result.output,
        "error_output": result.error_output,
    }


# ---- the host --------------------------------------------------------------------------------------------------------
@dataclass(frozen=True, slots=True)
class ProgramMission:
    """A program and the mission that its vehicle flies in, in place of a `Scenario`."""

    program: ProgramConfig
    spec: MissionSpec

    def to_json(self) -> dict[str, Any]:
        """Plain data, with a digest of the program's text."""
        return {"program": self.program.to_json(), "mission": self.spec.to_json()}

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
    samplings: Mapping[str, type[CallLevel]] = {"message": CallLevel}

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
        # only a program that has run tells which vehicles it adds
        vehicles: Sequence[str] = (self._program.vehicle,)
        if self._program.settings:
            capture = CaptureSize(*pixels(self._program.image), FIELD_OF_VIEW)
            settings = read_settings(Path(self._program.settings), capture)
            vehicles = [vehicle.name for vehicle in settings.vehicles] or vehicles
        if self._program.fault_vehicle not in ("", *vehicles):
            run_program(self._program, MissionSpec(), Boundary())


class ProgramRuns:
    """The runs of one mission."""

    def __init__(self, missions: Mapping[str, ProgramMission]) -> None:
        self._missions = missions
        self._golden: dict[str, ProgramResult] = {}

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
        if runs[0].errors:
            refusals = "; ".join(runs[0].errors)
            raise BadInputError(f"{mission.program.script}: calls are refused without a fault: {refusals}")
        if runs[0].how == "hang":
            raise BadInputError(f"{mission.program.script}: {runs[0].reason} without a fault; allowed: a larger wall_s")
        self._golden[arm] = runs[0]
        return RunResult(record_of_program(runs[0], runs[0]), tuple(runs[0].boundary.passed))

    def register_golden(self, arm: str, flight: Recorded) -> None:
        """See `MissionFlights.register_golden`; no operation, as no program is run elsewhere."""

    def injected(self, runs: Sequence[tuple[str, Fault]]) -> Iterator[tuple[int, Recorded | Exception]]:
        """See `one_by_one`."""

        def run(arm: str, fault: Fault) -> RunResult:
            mission = self._missions[arm]
            boundary = Boundary.of(cast(MessageFault | SensorFault, fault))
            result = run_program(mission.program, mission.spec, boundary)
            # that of a program that ended by itself does not depend on the error-free run, which need not be flown
            golden = result
            if result.how != "ended":
                golden = self._golden_run(arm)
            return RunResult(record_of_program(result, golden))

        return one_by_one(runs, run)

    def _golden_run(self, arm: str) -> ProgramResult:
        """The error-free run, which is run now if it was not before: a replay begins with a fault."""
        if arm not in self._golden:
            self.golden(arm)
        return self._golden[arm]


def record_of_program(result: ProgramResult, golden: ProgramResult) -> FlightRecord:
    """The record of a run.

    A program that still runs when its time is up hangs, if the error-free one (`golden`) ended.  An exit code other
    than 0 is a crash, if it is not that of the error-free one.
    """
    injection = result.boundary.injected
    injections: tuple[Injection, ...] = ()
    if injection is not None:
        injections = (injection,)
    extra = {"how": result.how, "calls": sum(result.calls.values()), "refused": sum(result.errors.values())}
    effects = {"program crash": Effect.EXCEPTION, "hang": Effect.HANG}
    if golden.how == "ended":
        effects["time is up"] = Effect.HANG
    effect = effects.get(result.how)
    if effect is not None and not result.ends_like(golden):
        reason = result.reason
        if result.how == "time is up":
            reason = "its time is up"
        return FlightRecord(
            End.DUE, injections=injections, kernel=KernelEffect(effect.label, reason), extra=extra, error=reason
        )
    return FlightRecord(
        End.FLOWN, result.status.label, result.digest, result.seconds, injections=injections, extra=extra
    )
