"""Runs a client program of AirSim in simulated time: `python runner.py PORT SCRIPT [ARGUMENTS]`.

It runs in the client's own Python and imports nothing of mavfi.  Sleeping, reading clocks and waiting for a task become
calls, on the program's own connection, so that their order is kept; keys are not awaited, and no window opens.
"""

import io
import os
import sys
import time
import traceback
import types

TIME_IS_UP = "mavfi: time is up"  # begins the error of every call after the time limit
EXIT_TIME_IS_UP = 75
EXIT_CRASH = 70
_START = 1600000000.0  # the simulation's first instant, as a Unix time
_FIRST_CLIENT = []  # the program's first client, once it has connected


def _airsim():
    """The client library: airsim, or Cosys-AirSim's as airsim."""
    try:
        import airsim
        from airsim import VehicleClient  # noqa: F401 - a folder of this name next to the program is not the library
    except ImportError:
        import cosysairsim as airsim

        sys.modules["airsim"] = airsim
        for part in ("client", "types", "utils"):
            sys.modules["airsim." + part] = sys.modules["cosysairsim." + part]
    return airsim


def _patch(port):
    """Patch the client library."""
    airsim = _airsim()
    from msgpackrpc.future import Future
    from msgpackrpc.session import Session

    # the originals, which the replacements below call
    original_init = airsim.VehicleClient.__init__
    original_join = Future.join
    original_get = Future.get

    def connect_to_server(self, ip="", port_=port, timeout_value=3600, *more, **options):
        options.pop("port", None)  # the server's port is not the program's choice
        original_init(self, "127.0.0.1", port, timeout_value)
        _FIRST_CLIENT.append(self.client)

    # answers: the end of the time limit ends the program
    def answer_of(future):
        original_join(future)
        try:
            return original_get(future)
        except Exception as error:
            if TIME_IS_UP in str(error):
                raise SystemExit(EXIT_TIME_IS_UP) from None
            raise

    def ask(method, *arguments):
        if _FIRST_CLIENT:
            return answer_of(Session.send_request(_FIRST_CLIENT[0], method, arguments))
        return None

    # the program waits for a task: time must pass in the server, which advances it in calls only
    def wait(future):
        """Let the server finish the task first."""
        while not future._set_flag:
            ask("mavfiFinish")
            if not future._set_flag:
                original_join(future)

    def wait_and_get(future):
        wait(future)
        return answer_of(future)

    # patch; a key is not awaited, its message is printed
    airsim.VehicleClient.__init__ = connect_to_server
    Session.call = lambda self, method, *arguments: answer_of(self.send_request(method, arguments))
    Future.join = wait
    Future.get = wait_and_get
    airsim.wait_key = lambda message="": sys.stdout.write(str(message) + "\n")
    airsim.utils.wait_key = airsim.wait_key
    return ask


def _clocks(ask):
    """A module `time` for the program and what it imports; libraries loaded before keep the real one."""

    def now():
        if _FIRST_CLIENT:
            return 1e-6 * ask("mavfiNow")
        return 0.0

    def sleep(seconds):
        if _FIRST_CLIENT:
            ask("mavfiSleep", max(0.0, float(seconds)))

    proxy = types.ModuleType("time")
    proxy.__dict__.update(time.__dict__)
    proxy.sleep = sleep
    proxy.time = lambda: _START + now()
    proxy.time_ns = lambda: round(1e9 * proxy.time())
    proxy.perf_counter = proxy.monotonic = proxy.process_time = now
    proxy.perf_counter_ns = proxy.monotonic_ns = lambda: round(1e9 * now())
    sys.modules["time"] = proxy
    return proxy


def _without_windows():
    try:
        import cv2
    except ImportError:
        return
    cv2.imshow = cv2.namedWindow = cv2.destroyAllWindows = lambda *arguments, **options: None
    cv2.waitKey = lambda *arguments: -1


def main():
    """Run the program; its exit code, or `EXIT_TIME_IS_UP` or `EXIT_CRASH`."""
    # as Python would start the script: its arguments, and its folder first on the path
    port = int(sys.argv[1])
    script = sys.argv[2]
    folder = os.path.dirname(os.path.abspath(script))
    sys.argv = sys.argv[2:]
    sys.path[0] = folder
    os.environ.setdefault("MPLBACKEND", "Agg")

    # repeatable: seeds, clocks, no windows
    import random

    random.seed(0)
    try:
        import numpy

        numpy.random.seed(0)
    except ImportError:
        pass
    _clocks(_patch(port))
    _without_windows()

    # run it; a crash has an exit code of its own
    with io.open_code(os.path.abspath(script)) as source:
        code = compile(source.read(), script, "exec")
    module = types.ModuleType("__main__")
    module.__file__ = script
    sys.modules["__main__"] = module
    try:
        exec(code, module.__dict__)
    except SystemExit:
        raise
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
        raise SystemExit(EXIT_CRASH) from None


if __name__ == "__main__":
    main()
