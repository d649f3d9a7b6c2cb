"""A server of AirSim's API: msgpack-rpc over TCP, on loopback only.

Request `[0, number, name, arguments]`, answer `[1, number, error, result]`; a task is answered when it ends.  Calls are
served one after the other, in the order in which they arrive.
"""

import asyncio
import contextlib
import socket
import time
from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple, NoReturn

from mavfi.errors import BadInputError, not_installed
from mavfi.extras.airsim.boundary import ARGUMENTS, RETURN, Boundary
from mavfi.extras.airsim.config import CALL_US
from mavfi.extras.airsim.runner import TIME_IS_UP
from mavfi.extras.airsim.table import Api, ApiScene, find_call, require_ready
from mavfi.sim.scene import STEP_US


# ---- how simulated time passes ---------------------------------------------------------------------------------------
class StepClock:
    """Time passes in calls.

    Attributes:
        limit_us: No time passes beyond this instant.
        waited_us: Time that the program spent while the simulation was paused; part of its clocks.
    """

    def __init__(self, call_us: int = CALL_US, limit_us: int = 10**15) -> None:
        self._call_us = call_us
        self.limit_us = limit_us
        self.waited_us = 0

    def before_call(self, scene: ApiScene) -> None:
        """Let the time of a call pass."""
        self._pass(scene, self._call_us)

    def after_call(self, scene: ApiScene) -> None:
        """Let time pass up to the next pause, if the call asked for that."""
        if scene.resume_until_us is not None:
            scene.step(min(self.limit_us, scene.resume_until_us))
            scene.paused = True
            scene.resume_until_us = None

    def sleep(self, scene: ApiScene, seconds: float) -> None:
        """A call comes later by this time."""
        self._pass(scene, max(STEP_US, round(seconds * 1e6 / STEP_US) * STEP_US))

    def now(self, scene: ApiScene) -> int:
        """Time of the program (us)."""
        return scene.now_us + self.waited_us

    def wait(self, scene: ApiScene, until_us: int | None, *, for_task: bool) -> None:
        """The program waits.

        Args:
            scene: The vehicles.
            until_us: An instant of the program's time (us); None = without an end.
            for_task: Whether the end of a task is waited for too.
        """
        if for_task and not scene.paused and scene.busy:
            if until_us is None:
                until_us = self.limit_us
            else:
                until_us = until_us - self.waited_us
            scene.finish(min(self.limit_us, until_us))
        elif until_us is None:
            self._pass(scene, self._call_us)  # for a task that does not end, e.g. because of a pause
        else:
            self._pass(scene, until_us - self.now(scene))

    def end(self, scene: ApiScene) -> None:
        """The program waits for ever: time passes to the limit, unless the simulation is paused."""
        self._pass(scene, self.limit_us - scene.now_us)

    def _pass(self, scene: ApiScene, duration_us: int) -> None:
        if scene.paused:
            self.waited_us += duration_us
            return
        scene.step(min(self.limit_us, scene.now_us + duration_us))


class RealClock:
    """Time passes with wall-clock time, times `speed`."""

    def __init__(self, speed: float = 1.0) -> None:
        self._speed = speed
        self._last = time.perf_counter()
        self._left_us = 0.0

    def before_call(self, scene: ApiScene) -> None:
        """See `StepClock.before_call`; a call takes no simulated time."""

    def after_call(self, scene: ApiScene) -> None:
        """See `StepClock.after_call`; `tick` lets time pass."""

    def sleep(self, scene: ApiScene, seconds: float) -> None:
        """See `StepClock.sleep`; time cannot pass at will, and servers refuse what would need it."""
        raise NotImplementedError

    def tick(self, scene: ApiScene) -> None:
        """Let the time since the last tick pass."""
        now = time.perf_counter()
        self._left_us += 1e6 * self._speed * (now - self._last)
        self._last = now
        if scene.paused:
            self._left_us = 0.0
            return
        steps = int(self._left_us // STEP_US)
        target = scene.now_us + steps * STEP_US
        self._left_us -= steps * STEP_US
        if scene.resume_until_us is not None and target >= scene.resume_until_us:
            target = scene.resume_until_us
            scene.paused = True
            scene.resume_until_us = None
        scene.step(target)


# ---- the server ------------------------------------------------------------------------------------------------------
HOST = "127.0.0.1"
PORT = 41451
_REQUEST = 0
_RESPONSE = 1
_READ = 1 << 16
Reply = Callable[[str | None, Any], None]


def msgpack() -> Any:
    """The package msgpack.

    Raises:
        NotInstalledError: It is not installed.
    """
    try:
        import msgpack as package
    except ImportError:
        raise not_installed("AirSim's API", "msgpack", "airsim") from None
    return package


class WaitingTask(NamedTuple):
    """A call that is answered when its task ends: how, its name, its arguments, and the boundary that it passes."""

    reply: Reply
    name: str
    arguments: list[Any]
    boundary: Boundary


class AirsimServer:
    """Serves the vehicles of a scene.

    Args:
        api: The first of them.
        clock: Advances the vehicle.
        boundary: Faults and detector.
        single: Whether numbers are sent as float32, as by AirSim.

    Attributes:
        calls: Number of calls by name.
        errors: Number of errors by message.
        finished: Set while no client is connected, once there was one.
        last_wait: What the program waited for when its time was up; "" = it was not.
        last_call: The last call of the program, and the instant of the simulation; "" = there was none.
        last_call_s: Wall-clock time of the last call of program or runner (s).
    """

    def __init__(
        self, api: Api, clock: RealClock | StepClock, boundary: Boundary | None = None, *, single: bool = False
    ) -> None:
        self.api = api
        self.clock = clock
        self.boundary = boundary or Boundary()
        if self.boundary.delays and isinstance(clock, RealClock):
            text = "simulated time passes in real time; allowed: with --clock steps, or mavfi airsim run"
            raise BadInputError(f"--fault: delay: {text}")
        self._attach_failure()
        self._msgpack = msgpack()
        self._pack = self._msgpack.Packer(use_bin_type=True, use_single_float=single).pack
        self._waiting: dict[tuple[str, int], WaitingTask] = {}  # by vehicle and number
        self._connections: dict[asyncio.StreamWriter, asyncio.Task[None]] = {}
        self._ending = False
        self.calls: Counter[str] = Counter()
        self.errors: Counter[str] = Counter()
        self.finished = asyncio.Event()
        self.last_wait = ""
        self.last_call = ""
        self.last_call_s = 0.0

    # ---- calls ------------------------------------------------------------------------------------------------------
    def serve_call(self, name: Any, arguments: list[Any], reply: Reply) -> None:
        """Serve one call; `reply` is called with error and result, now or when its task ends."""
        self.last_call_s = time.monotonic()
        try:
            if isinstance(self.clock, StepClock) and isinstance(name, str) and name.startswith("mavfi"):
                result = self._of_runner(self.clock, name, arguments)
                self.flush()  # a task's answer comes before that of the call that waited for it
                reply(None, result)
            else:
                self._serve(name, arguments, reply)
        except Exception as error:  # noqa: BLE001 - arguments of any type can come from a client
            self._refuse(name, error, reply)
        self.flush()

    def _refuse(self, name: Any, error: Exception, reply: Reply) -> None:
        """Answer with an error that names the call."""
        text = str(error)
        if str(name) not in text:
            text = f"{name}: {error}"
        if TIME_IS_UP not in text:  # the end of the run, not a fault of the call
            self.errors[text] += 1
        reply(text, None)

    def _serve(self, name: Any, arguments: list[Any], reply: Reply) -> None:
        """Serve a call of the API: check it, pass it through the boundary, and answer now or when its task ends."""
        scene = self.api.scene
        call = find_call(name)
        self.calls[name] += 1
        self.last_call = f"{name} at {1e-6 * scene.now_us:.3f} s"
        self.clock.before_call(scene)
        self._check_time(name)
        call.check(arguments)
        api = call.addressed(scene, arguments)
        boundary = self._boundary_of(api, is_of_vehicle=call.names_vehicle)

        # A fault in the whole call: it is not executed, later, repeatedly, or with what the first one had.
        operation = boundary.operation_on(name, arguments, api.vehicle.now_us)
        executions = 1
        if operation is not None and operation.name == "drop":
            reply(None, boundary.last_answer)
            return
        if operation is not None and operation.name == "delay":
            self.clock.sleep(scene, operation.value or 0.0)
            self._check_time(name)
        if operation is not None and operation.name == "duplicate":
            executions += operation.count
        is_frozen = operation is not None and operation.name == "freeze"
        if is_frozen:
            arguments = boundary.freeze(ARGUMENTS, arguments)

        arguments = boundary.arguments(name, arguments, api.vehicle.now_us)
        if call.is_task:
            require_ready(api, name)
            for _ in range(executions):
                number = api.vehicle.start(call.run(api, arguments))
            self._waiting[api.name, number] = WaitingTask(reply, name, arguments, boundary)
            return
        for _ in range(executions):
            result = call.run(api, arguments)
        if is_frozen:
            result = boundary.freeze(RETURN, result)
        if name == "simAddVehicle":
            self._attach_failure()
        self.clock.after_call(scene)
        reply(None, boundary.returned(name, arguments, result, api.vehicle.now_us))

    def _boundary_of(self, api: Api, *, is_of_vehicle: bool) -> Boundary:
        """What a call passes: the boundary, or one without a fault if the call is of another vehicle."""
        if is_of_vehicle and api.name != (self.boundary.vehicle or api.scene.first.name):
            return Boundary()
        return self.boundary

    def _attach_failure(self) -> None:
        """Let the vehicle with the fault fail, as soon as it is there."""
        failure = self.boundary.failure
        name = self.boundary.vehicle or self.api.name
        if failure is None or name not in self.api.scene.vehicles:
            return
        active = self.api.scene.vehicles[name].vehicle.failures.active
        if failure not in active:
            active.append(failure)

    def _of_runner(self, clock: StepClock, name: str, arguments: list[Any]) -> int:
        """Calls of the runner in the client's process; the program's instant (us)."""
        scene = self.api.scene
        if name == "mavfiPass":
            until_us, for_task, what = arguments
            if until_us is None and not for_task:
                clock.end(scene)
                if scene.paused:
                    what = f"{what}, while the simulation is paused"
                self._refuse_more(what)
            clock.wait(scene, until_us, for_task=for_task)
            tasks = [waiting.name for waiting in self._waiting.values()]
            if for_task and tasks:
                what = ", ".join(tasks)
            self._check_time(what)
        elif name == "mavfiNow":  # takes the time of a call, so that polling ends
            self._check_time(*arguments or ("a clock",))
            clock.before_call(scene)
        elif name == "mavfiClock":
            self._check_time("a clock")
        else:
            raise BadInputError(f"server could not find function {name!r}")
        return clock.now(scene)

    def _check_time(self, what: str) -> None:
        """Refuse a call after the time limit; `what`: the call, or what the program waits for."""
        if isinstance(self.clock, StepClock) and self.api.scene.now_us >= self.clock.limit_us:
            self._refuse_more(what)

    def _refuse_more(self, what: str) -> NoReturn:
        """Refuse a call, as the program's time is up; `what`: see `_check_time`."""
        self.last_wait = self.last_wait or what
        raise BadInputError(f"{TIME_IS_UP} ({1e-6 * self.api.scene.now_us:g} s)")

    def flush(self) -> None:
        """Answer the tasks that have ended."""
        for api in self.api.scene.vehicles.values():
            for ended in api.vehicle.ended_tasks:
                waiting = self._waiting.pop((api.name, ended.number), None)
                if waiting is None:
                    continue
                if isinstance(ended.result, Exception):
                    self._refuse(waiting.name, ended.result, waiting.reply)
                else:
                    now_us = api.vehicle.now_us
                    result = waiting.boundary.returned(waiting.name, waiting.arguments, ended.result, now_us)
                    waiting.reply(None, result)
            api.vehicle.ended_tasks.clear()

    # ---- connections ------------------------------------------------------------------------------------------------
    def connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve a client; its connection is known before its task begins, which may be cancelled before that."""
        if self._ending:
            writer.transport.abort()
            return
        self.finished.clear()
        self._connections[writer] = asyncio.create_task(self._serve_client(reader, writer))

    async def _serve_client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one client until it leaves."""
        raw = writer.get_extra_info("socket")
        raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        unpacker = self._msgpack.Unpacker(raw=False, strict_map_key=False, unicode_errors="surrogateescape")
        try:
            while data := await reader.read(_READ):
                # a client's Nagle waits for an acknowledgement after each unjoined task, which Linux delays by 40 ms
                raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
                unpacker.feed(data)
                for request in unpacker:
                    self._request(writer, request)
                await writer.drain()
        except (ConnectionError, self._msgpack.exceptions.UnpackException, ValueError):
            pass  # the client left, or speaks another protocol
        finally:
            self._connections.pop(writer, None)
            writer.transport.abort()  # nobody reads what is left: `close` would wait for that
            if not self._connections:
                self.finished.set()

    def _request(self, writer: asyncio.StreamWriter, request: Any) -> None:
        if not isinstance(request, list) or len(request) != 4 or request[0] != _REQUEST:
            raise ValueError("not a request of msgpack-rpc")
        _, number, name, arguments = request

        def reply(error: str | None, result: Any) -> None:
            with contextlib.suppress(ConnectionError):
                writer.write(self._pack([_RESPONSE, number, error, result]))

        if not isinstance(arguments, (list, tuple)):
            arguments = [arguments]
        self.serve_call(name, list(arguments), reply)

    async def run(self, port: int, ready: Callable[[int], None], *, once: bool = False) -> None:
        """Serve on loopback until cancelled, or (`once`) until the last client has left.

        Args:
            port: 0 = any free one.
            ready: Called with the port when clients can connect.
            once: Whether to end with the last client.

        Raises:
            BadInputError: The port is taken.
        """
        try:
            server = await asyncio.start_server(self.connected, HOST, port)
        except OSError as error:
            raise BadInputError(f"--port: {port}: {error.strerror or error}; allowed: a free port") from None
        ready(server.sockets[0].getsockname()[1])
        ticking = None
        if isinstance(self.clock, RealClock):
            ticking = asyncio.create_task(self._tick())
        try:
            if once:
                await self.finished.wait()
            else:
                await asyncio.Event().wait()  # until cancelled
        finally:
            # no further calls, then no further clients, then the ones that are connected
            if ticking is not None:
                ticking.cancel()
            self._ending = True
            for listening in server.sockets:
                asyncio.get_running_loop().remove_reader(listening)
            try:
                await asyncio.sleep(0)  # asyncio leaves a connection open that it has accepted, but not yet begun
            finally:
                server.close()
                for writer in self._connections:
                    writer.transport.abort()

    async def _tick(self) -> None:
        assert isinstance(self.clock, RealClock)  # precondition
        while True:
            await asyncio.sleep(0.004)
            self.clock.tick(self.api.scene)
            self.flush()
