"""Runs a client program of AirSim in simulated time: `python runner.py PORT SCRIPT [ARGUMENTS]`.

It runs in the client's own Python and imports nothing of mavfi.  Reading clocks and waiting, whether for a time, a task
or another thread, become calls on the program's own connections, so that their order is kept; keys are not awaited, and
no window opens.

Threads share one time, and one of them runs at a time, so that the order of their calls is the same in each run: a
thread has the turn until it waits; then the first one whose wait has ended has it.  When none has, time passes, up to
the next deadline or the end of a task.
"""

import asyncio
import builtins
import concurrent.futures.thread
import copyreg
import datetime
import io
import os
import queue
import select
import selectors
import signal
import socket
import subprocess
import sys
import threading
import time
import traceback
import types
from contextlib import contextmanager
from functools import partial

TIME_IS_UP = "mavfi: time is up"  # begins the error of every call after the time limit
EXIT_TIME_IS_UP = 75
EXIT_CRASH = 70
_START = 1600000000.0  # the simulation's first instant, as a Unix time
_STEP_US = 4_000  # sleeps are rounded to the physics' period
_STUCK_S = 0.5  # wall-clock time after which a thread that neither calls nor computes is no longer waited for
_LONGEST_COMPUTATION_S = 10.0  # the same for a thread that computes
_LONGEST_DEADLOCK_S = 2.0  # wall-clock time in which all wait for one another, after which time passes to its end
_LONGEST_SILENCE_S = 30.0  # the same if one waits for what may come from outside, e.g. a file
_POLL_S = 0.001  # wall-clock time between looks at what another thread does
_FREE_READINGS = 100  # of an event loop's clock between two calls; more of them take time, so that polling ends

_SESSIONS = []  # the program's connections, the first one first
_TALK = threading.RLock()  # msgpackrpc is not made for threads: one thread talks at a time
_event_loop_policy = getattr(asyncio.events, "_get_event_loop_policy", asyncio.get_event_loop_policy)
_real_sleep = time.sleep
_real_time = time.monotonic


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


# ---- calls on the program's connections ------------------------------------------------------------------------------
@contextmanager
def _talking(loop):
    """Talk to the server, also inside of an event loop of the program; `loop`: asyncio's of the client, or None."""
    with _TALK:
        running = asyncio.events._get_running_loop()
        local = getattr(_event_loop_policy(), "_local", types.SimpleNamespace())
        current = getattr(local, "_loop", None), getattr(local, "_set_called", False)
        asyncio.events._set_running_loop(None)
        if loop is not None:
            local._loop = loop
        try:
            yield
        finally:
            local._loop, local._set_called = current
            asyncio.events._set_running_loop(running)


class _Calls:
    """Calls of the runner and of the program."""

    def __init__(self):
        from msgpackrpc.future import Future
        from msgpackrpc.session import Session

        self.join = Future.join
        self.get = Future.get
        self.send_request = Session.send_request
        self.number = 0  # of calls that may have let time pass

    def send(self, session, method, arguments):
        """Send a call; the future of its answer."""
        with _talking(session._mavfi_loop):
            future = self.send_request(session, method, arguments)
        future._mavfi_session = session
        return future

    def answer_of(self, future):
        """The answer to a call; the end of the time limit ends the program."""
        try:
            with _talking(future._mavfi_session._mavfi_loop):
                self.join(future)
                return self.get(future)
        except Exception as error:
            if TIME_IS_UP in str(error):
                _end_of_time()
            raise

    def call(self, session, method, *arguments):
        """A call of the program, which lets time pass."""
        _WAITS.take_turn()
        answer = self.answer_of(self.send(session, method, arguments))
        self.number += 1
        _WAITS.active()
        return answer

    def post(self, session, method, arguments):
        """A call of the program for a task; the future of its answer."""
        _WAITS.take_turn()
        return self.send(session, method, arguments)

    def ask(self, method, *arguments, session=None):
        """A call of the runner; None as long as the program has no connection."""
        if not _SESSIONS:
            return None
        session = session or _SESSIONS[0]
        return self.answer_of(self.send(session, method, arguments))


def _end_of_time():
    """End the program: the main thread by an exception, which lets it clean up."""
    if threading.current_thread() is threading.main_thread():
        raise SystemExit(EXIT_TIME_IS_UP) from None
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(EXIT_TIME_IS_UP)


def _patch(port):
    """Patch the client library; returns the calls."""
    airsim = _airsim()
    from msgpackrpc.future import Future
    from msgpackrpc.session import Session

    calls = _Calls()
    original_init = airsim.VehicleClient.__init__
    original_call = Session.call
    original_call_async = Session.call_async

    def connect_to_server(self, ip="", port_=port, timeout_value=3600, *more, **options):
        options.pop("port", None)  # the server's port is not the program's choice
        loop = asyncio.new_event_loop()  # Cosys-AirSim's client would share the program's
        loop._mavfi_is_of_client = True
        with _talking(loop):
            original_init(self, "127.0.0.1", port, timeout_value)
        self.client._mavfi_loop = loop
        _SESSIONS.append(self.client)

    # sessions and futures of another server, if the program talks to one, are left alone
    def call(session, method, *arguments):
        if session in _SESSIONS:
            return calls.call(session, method, *arguments)
        return original_call(session, method, *arguments)

    def call_async(session, method, *arguments):
        if session in _SESSIONS:
            return calls.post(session, method, arguments)
        return original_call_async(session, method, *arguments)

    def wait_for_task(future):
        """Time must pass in the server until the task has ended."""
        if not hasattr(future, "_mavfi_session"):
            calls.join(future)
        elif not future._set_flag:
            _WAITS.until(lambda: future._set_flag, session=future._mavfi_session)

    def wait_and_get(future):
        wait_for_task(future)
        if not hasattr(future, "_mavfi_session"):
            return calls.get(future)
        return calls.answer_of(future)

    airsim.VehicleClient.__init__ = connect_to_server
    Session.call = call
    Session.call_async = call_async
    Future.join = wait_for_task
    Future.get = wait_and_get
    airsim.wait_key = lambda message="": sys.stdout.write(str(message) + "\n")
    airsim.utils.wait_key = airsim.wait_key
    return calls


# ---- waiting, in simulated time --------------------------------------------------------------------------------------
class _Waiter:
    """A thread that waits.

    Attributes:
        thread: The thread.
        is_ready: Whether what it waits for is there; asked without effect.
        deadline_us: The instant after which it waits no longer; None = never.
        session: The connection on which the answer of its task comes; None = it waits for no task.
        what: What the program does meanwhile.
        watches_files: Whether it waits for files, which may come from outside of the program.
        number: The number of calls when it last looked.
    """

    def __init__(self, thread, is_ready, session, what, watches_files):
        self.thread = thread
        self.is_ready = is_ready
        self.deadline_us = None
        self.session = session
        self.what = what
        self.watches_files = watches_files
        self.number = -1

    def has_ended(self, now_us):
        """Whether what it waits for is there, or its time is up."""
        return self.is_ready() or (self.deadline_us is not None and self.deadline_us <= now_us)


_ITS_TURN, _TIME_PASSES, _NOT_YET = range(3)  # what a waiting thread does next


class _Waits:
    """The threads that wait, whose turn it is, and the time that passes when all of them wait."""

    def __init__(self):
        self.calls = None  # set when the client library is patched
        self._turn = threading.main_thread()
        self._waiters = {}  # by thread
        self._started = 0  # number of threads

    def take_turn(self):
        """Wait until no other thread has the turn."""
        self.active()
        if self._turn is not threading.current_thread():
            self.until(lambda: True)

    def active(self):
        """Note that this thread does something."""
        threading.current_thread()._mavfi_active_s = _real_time()

    def number_thread(self, thread):
        """Number a thread that starts: the order in which they have the turn."""
        self._started += 1
        thread._mavfi_number = self._started

    def until(self, is_ready, seconds=None, session=None, what="", *, watches_files=False):
        """Wait until something is there or (if not None) seconds have passed; whether it is there.

        Args:
            is_ready: Whether it is there; asked from other threads too.
            seconds: Simulated time.
            session: The connection on which the answer of a task comes, if that is waited for.
            what: What the program does meanwhile; named if its time is up.
            watches_files: Whether it waits for files.
        """
        thread = threading.current_thread()
        if self._turn is thread and is_ready():
            return True
        self.active()
        if not _SESSIONS:
            return self._without_connection(is_ready, seconds)
        waiter = _Waiter(thread, is_ready, session, what, watches_files)
        now_us = self._look(waiter)
        if seconds is not None:
            waiter.deadline_us = now_us + max(_STEP_US, round(seconds * 1e6 / _STEP_US) * _STEP_US)
        self._waiters[thread] = waiter
        if self._turn is thread:
            self._turn = None
        try:
            while True:
                # calls of other threads let time pass, and a task's answer comes with the answer to a call
                if waiter.number != self.calls.number:
                    now_us = self._look(waiter)
                before_us = now_us
                with _TALK:
                    step = self._next(waiter, now_us)
                    if step == _ITS_TURN:
                        self._turn = thread
                        return is_ready()
                    if step == _TIME_PASSES:
                        now_us = self._pass(waiter, now_us)
                if now_us == before_us:
                    _real_sleep(_POLL_S)
        finally:
            self.active()  # first, as others look at either
            del self._waiters[thread]

    def _look(self, waiter):
        """The instant (us); answers of tasks that have come are taken."""
        number = self.calls.number
        now_us = self.calls.ask("mavfiClock", session=waiter.session)
        waiter.number = number  # not before: others rely on that the answers have been taken
        return now_us

    def _without_connection(self, is_ready, seconds):
        """Wait for another thread in wall-clock time: no time is simulated so far."""
        end = None
        if seconds is not None:
            end = _real_time() + seconds
        while not is_ready():
            if end is not None and (_real_time() >= end or threading.active_count() == 1):
                return False
            _real_sleep(_POLL_S)
        return True

    def _next(self, waiter, now_us):
        """What a waiting thread does next."""
        # no thread runs; the ones that wait do not begin to, as this one decides
        waiters = []
        for thread in threading.enumerate():
            if thread in self._waiters:
                waiters.append(self._waiters[thread])
            elif not self._is_stuck(thread):
                return _NOT_YET

        # checked afterwards: a thread may have made something ready, and ended, just before
        if any(other.number != self.calls.number for other in waiters):
            return _NOT_YET
        ended = [other for other in waiters if other.has_ended(now_us)]
        if not ended:
            return _TIME_PASSES
        if waiter is min(ended, key=lambda other: getattr(other.thread, "_mavfi_number", 0)):
            return _ITS_TURN
        return _NOT_YET

    @staticmethod
    def _is_stuck(thread):
        """Whether a thread that does not wait here has done nothing for long: it waits for something else."""
        now = _real_time()
        cpu_s = 0.0
        if thread.ident is not None and hasattr(time, "pthread_getcpuclockid"):
            try:
                cpu_s = time.clock_gettime(time.pthread_getcpuclockid(thread.ident))
            except OSError:  # it has just ended
                return True
        if not hasattr(thread, "_mavfi_active_s"):
            thread._mavfi_active_s = now
        if getattr(thread, "_mavfi_cpu_s", None) != cpu_s:
            thread._mavfi_cpu_s = cpu_s
            thread._mavfi_computed_s = now
        idle_s = now - max(thread._mavfi_active_s, thread._mavfi_computed_s)
        return idle_s > _STUCK_S or now - thread._mavfi_active_s > _LONGEST_COMPUTATION_S

    def _pass(self, waiter, now_us):
        """Let time pass to the next deadline, or to the end of a task if one is waited for; the new instant (us)."""
        waiters = list(self._waiters.values())
        deadlines = [other.deadline_us for other in waiters if other.deadline_us is not None]
        waits_for_task = any(other.session is not None for other in waiters)
        if not deadlines and not waits_for_task and not self._is_for_ever():
            return now_us  # what all wait for may still come from outside
        until_us = min(deadlines, default=None)
        what = self._waiters.get(threading.main_thread(), waiter).what
        now_us = self.calls.ask("mavfiPass", until_us, waits_for_task, what, session=waiter.session)
        self.calls.number += 1
        waiter.number = self.calls.number
        return now_us

    def _is_for_ever(self):
        """Whether all threads have waited without an end for so long that nothing from outside will end that."""
        threads = threading.enumerate()
        waiters = [self._waiters.get(thread) for thread in threads]
        longest_s = _LONGEST_DEADLOCK_S
        if any(waiter is None or waiter.watches_files for waiter in waiters):
            longest_s = _LONGEST_SILENCE_S
        last_s = max(getattr(thread, "_mavfi_active_s", 0.0) for thread in threads)
        return _real_time() - last_s > longest_s


_WAITS = _Waits()


def _name_of_wait():
    """The method that waits by a condition as the program has called it, e.g. "Event.wait"."""
    frame = sys._getframe(2)
    caller = None
    while frame is not None and frame.f_globals.get("__name__") in ("threading", "queue", "concurrent.futures._base"):
        caller = frame
        frame = frame.f_back
    if caller is None:
        return "Condition.wait"
    return type(caller.f_locals.get("self")).__name__ + "." + caller.f_code.co_name


class _Lock:
    """A `threading.Lock` for which threads wait in simulated time."""

    def __init__(self):
        self._lock = threading._allocate_lock()
        self.release = self._lock.release
        self.locked = self._lock.locked
        self._at_fork_reinit = getattr(self._lock, "_at_fork_reinit", None)

    def acquire(self, blocking=True, timeout=-1):
        if self._lock.acquire(False):
            return True
        if not blocking or timeout == 0 or not _SESSIONS or _TALK._is_owned():
            return self._lock.acquire(blocking, timeout)
        if timeout < 0 and timeout != -1:
            raise ValueError("timeout value must be a non-negative number")
        if timeout == -1:
            timeout = None
        end = None
        if timeout is not None:
            end = threading._time() + timeout
        # another thread may have it just before, so that it is waited for again
        while _WAITS.until(lambda: not self._lock.locked(), timeout, what="Lock.acquire"):
            if self._lock.acquire(False):
                return True
            if end is not None:
                timeout = max(0.0, end - threading._time())
        return False

    __enter__ = acquire

    def __exit__(self, *error):
        self.release()


class _ReentrantLock(threading._PyRLock):
    """A `threading.RLock` for which threads wait in simulated time."""

    def __init__(self):
        super().__init__()
        self._block = _Lock()


def _patch_threads(clock):
    """Let threads wait in simulated time: all of the module's waits are made of these."""

    def condition_wait(self, timeout=None):
        if not self._is_owned():
            raise RuntimeError("cannot wait on un-acquired lock")
        waiter = threading._allocate_lock()
        waiter.acquire()
        self._waiters.append(waiter)
        state = self._release_save()
        is_notified = False
        try:
            is_notified = _WAITS.until(lambda: not waiter.locked(), timeout, what=_name_of_wait())
            return is_notified
        finally:
            self._acquire_restore(state)
            if not is_notified:
                try:
                    self._waiters.remove(waiter)
                except ValueError:
                    pass

    original_start = threading.Thread.start

    def start_thread(self):
        _WAITS.number_thread(self)
        original_start(self)

    original_join = threading.Thread.join

    def join_thread(self, timeout=None):
        if self._started.is_set() and self is not threading.current_thread():
            _WAITS.until(lambda: not self.is_alive(), timeout, what="Thread.join")
            if self.is_alive():
                return
        original_join(self)

    threading.Condition.wait = condition_wait
    threading.Thread.join = join_thread
    threading.Thread.start = start_thread
    threading._time = clock
    threading.Lock = _Lock
    threading.RLock = _ReentrantLock
    queue.time = clock
    queue.SimpleQueue = queue._PySimpleQueue  # the other one waits outside of Python


def _wait_for_files(poll, seconds, what):
    """Wait in simulated time for one of several files; what `poll`, which takes the longest time (s), returns then."""
    if _TALK._is_owned():  # the client library itself waits for its answer
        return poll(seconds)
    ready = poll(0)
    if any(ready) or not _SESSIONS or (seconds is not None and seconds <= 0):
        if any(ready):
            return ready
        return poll(seconds)
    last = [ready]

    def is_ready():
        if not any(last[0]):
            last[0] = poll(0)
        return any(last[0])

    _WAITS.until(is_ready, seconds, what=what, watches_files=True)
    return last[0]


class _Poll:
    """A poll object of the module `select` that waits in simulated time.

    Args:
        real: The object.
        unit: Of its time-outs (s).
        name: Of its type.
    """

    def __init__(self, real, unit, name):
        self._real = real
        self._unit = unit
        self._name = name

    def __getattr__(self, name):
        return getattr(self._real, name)

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self._real.close()

    def poll(self, timeout=None, *more):
        seconds = None
        if timeout is not None and timeout >= 0:
            seconds = timeout * self._unit

        def poll(seconds):
            if seconds is None:
                return self._real.poll(-1, *more)
            return self._real.poll(seconds / self._unit, *more)

        return _wait_for_files(poll, seconds, self._name + ".poll")


def _patch_files():
    """Let the program wait for files in simulated time; what was imported before keeps the real functions."""
    real_select = select.select

    def wait_by_select(readable, writable, exceptional, timeout=None):
        return _wait_for_files(
            lambda seconds: real_select(readable, writable, exceptional, seconds), timeout, "select.select"
        )

    select.select = wait_by_select
    for name, unit in (("poll", 0.001), ("epoll", 1.0)):
        make = getattr(select, name, None)
        if make is not None:

            def wrapped(*arguments, _make=make, _unit=unit, _name="select." + name, **options):
                return _Poll(_make(*arguments, **options), _unit, _name)

            setattr(select, name, wrapped)

    class Selector(selectors.DefaultSelector):
        def select(self, timeout=None):
            if asyncio.events._get_running_loop() is not None:  # the loop itself takes care
                return super().select(timeout)
            return _wait_for_files(super().select, timeout, "a selector")

    selectors.DefaultSelector = Selector


def _patch_loops(clock):
    """Let event loops wait in simulated time, except those of the client."""
    base = asyncio.base_events.BaseEventLoop
    real_run_forever = base.run_forever
    real_time = base.time
    readings = [0, 0]  # the number of calls at the last reading, and that of readings since the last call

    def is_of_client(loop):
        return getattr(loop, "_mavfi_is_of_client", False)

    def loop_time(self):
        if is_of_client(self) or not _SESSIONS:
            return real_time(self)
        number = _WAITS.calls.number
        if number != readings[0]:
            readings[:] = [number, 0]
        readings[1] += 1
        if readings[1] > _FREE_READINGS:
            _WAITS.calls.ask("mavfiNow")
        return clock()

    def run_forever(self):
        selector = self._selector
        if not is_of_client(self) and not hasattr(selector, "_mavfi_select"):
            real_select = selector.select
            selector._mavfi_select = real_select
            selector.select = lambda timeout=None: _wait_for_files(real_select, timeout, "the event loop")
        return real_run_forever(self)

    base.time = loop_time
    base.run_forever = run_forever


def _patch_dates(clock):
    """Let `now`, `utcnow` and `today` of the module `datetime` show the time of `clock`, a module like `time`.

    The classes cannot be changed: the program gets others, which make objects of the real ones.
    """
    real_date = datetime.date
    real_datetime = datetime.datetime

    class OfSimulation(type):
        """Of a class that stands for a real one; classes that a program derives from it are its own."""

        def __instancecheck__(cls, value):
            real = cls.__dict__.get("_mavfi_real")
            if real:
                return isinstance(value, real)
            return type.__instancecheck__(cls, value)

        def __subclasscheck__(cls, other):
            real = cls.__dict__.get("_mavfi_real")
            if real:
                return issubclass(other, real)
            return type.__subclasscheck__(cls, other)

    class Date(real_date, metaclass=OfSimulation):
        _mavfi_real = real_date

        def __new__(cls, *arguments, **options):
            return real_date.__new__(cls.__dict__.get("_mavfi_real", cls), *arguments, **options)

        @classmethod
        def today(cls):
            return cls.fromtimestamp(clock.time())

    class Datetime(real_datetime, metaclass=OfSimulation):
        _mavfi_real = real_datetime

        def __new__(cls, *arguments, **options):
            return real_datetime.__new__(cls.__dict__.get("_mavfi_real", cls), *arguments, **options)

        @classmethod
        def now(cls, tz=None):
            return cls.fromtimestamp(clock.time(), tz)

        @classmethod
        def utcnow(cls):
            utc = datetime.timezone.utc  # noqa: UP017 - older Pythons run this file
            return cls.fromtimestamp(clock.time(), utc).replace(tzinfo=None)

        @classmethod
        def today(cls):
            return cls.fromtimestamp(clock.time())

    # objects are pickled by the name of their class, which is that of the other one now
    for real, other in ((real_date, Date), (real_datetime, Datetime)):
        other.__name__ = other.__qualname__ = real.__name__
        other.__module__ = real.__module__
        copyreg.pickle(real, lambda value, _other=other: (_other, value.__reduce_ex__(4)[1]))
    datetime.date = Date
    datetime.datetime = Datetime


def _say_what_is_real():
    """Say on stderr, once each, which time-outs of the program are in wall-clock time."""
    said = set()

    def say(owner, name, what, is_used):
        real = getattr(owner, name, None)
        if real is None:
            return

        def function(*arguments, **options):
            if what not in said and is_used(*arguments, **options):
                said.add(what)
                sys.stderr.write("mavfi: " + what + ": takes wall-clock time, not simulated time\n")
            return real(*arguments, **options)

        setattr(owner, name, function)

    say(signal, "alarm", "signal.alarm", lambda seconds: seconds > 0)
    say(signal, "setitimer", "signal.setitimer", lambda which, seconds, interval=0.0: seconds > 0)
    say(signal, "sigtimedwait", "signal.sigtimedwait", lambda signals, timeout: timeout > 0)
    say(socket.socket, "settimeout", "socket.settimeout", lambda this, seconds: bool(seconds))
    say(subprocess.Popen, "wait", "timeout= of subprocess", lambda this, timeout=None: bool(timeout))
    say(
        subprocess.Popen,
        "communicate",
        "timeout= of subprocess",
        lambda this, *arguments, **options: bool(arguments[1:] or options.get("timeout")),
    )
    if hasattr(signal, "pause"):
        signal.pause = lambda: _WAITS.until(lambda: False, what="signal.pause") and None


def _of_present(function, present):
    """A function of a moment, that of the present one if it is called without a moment or with None."""

    def of_moment(moment=None):
        if moment is None:
            moment = present()
        return function(moment)

    return of_moment


def _clocks(calls):
    """A module `time` for the program and what it imports; libraries loaded before keep the real one."""

    def clock():
        """Read without taking time (s), for deadlines."""
        if _SESSIONS:
            return 1e-6 * calls.ask("mavfiClock")
        return 0.0

    def now():
        if _SESSIONS:
            _WAITS.take_turn()
            return 1e-6 * calls.ask("mavfiNow")
        return 0.0

    def sleep(seconds):
        if _SESSIONS:
            _WAITS.until(lambda: False, max(0.0, float(seconds)), what="time.sleep")

    proxy = types.ModuleType("time")
    proxy.__dict__.update(time.__dict__)
    proxy.sleep = sleep
    proxy.time = lambda: _START + now()
    proxy.time_ns = lambda: round(1e9 * proxy.time())
    proxy.perf_counter = proxy.monotonic = proxy.process_time = proxy.thread_time = now
    proxy.perf_counter_ns = proxy.monotonic_ns = proxy.process_time_ns = proxy.thread_time_ns = lambda: round(
        1e9 * now()
    )
    if hasattr(time, "clock_gettime"):
        clocks = {time.CLOCK_REALTIME: lambda: proxy.time()}
        proxy.clock_gettime = lambda clock_id: clocks.get(clock_id, now)()
        proxy.clock_gettime_ns = lambda clock_id: round(1e9 * proxy.clock_gettime(clock_id))

    # without an argument, these are of the present time
    for name in ("localtime", "gmtime", "ctime"):
        setattr(proxy, name, _of_present(getattr(time, name), lambda: proxy.time()))
    proxy.asctime = _of_present(time.asctime, lambda: proxy.localtime())
    proxy.strftime = lambda form, *moment: _of_present(partial(time.strftime, form), lambda: proxy.localtime())(*moment)
    sys.modules["time"] = proxy
    concurrent.futures._base.time = proxy
    _patch_dates(proxy)
    _patch_files()
    _say_what_is_real()
    _patch_threads(clock)
    _patch_loops(clock)


def _without_terminal(calls):
    """Read lines of the standard input without waiting for a key; show no window."""

    def read_line(prompt=""):
        sys.stdout.write(str(prompt))
        line = sys.stdin.readline()
        if not line:  # nobody is there to press a key; a program that asks for ever runs out of time
            calls.ask("mavfiNow", "input()")
        sys.stdout.write("\n")
        return line.rstrip("\n")

    builtins.input = read_line
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
    calls = _patch(port)
    _WAITS.calls = calls
    _clocks(calls)
    _without_terminal(calls)

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
