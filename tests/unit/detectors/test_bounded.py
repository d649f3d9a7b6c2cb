"""The limit on calls of detectors: what does not return is stopped, or repeated without that call, in time.

Signals and timers stay as they were.
"""

import ctypes
import os
import signal
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import pytest

from mavfi.detectors import bounded as module
from mavfi.detectors.bounded import StuckError, bounded, limited, split_again
from mavfi.detectors.detector import Chain, Detector, NoDetector
from mavfi.detectors.replicas import replicated
from mavfi.ir.forked import WALL_CLOCK, Ended, ForkPoint
from mavfi.states import new_state


class Own(Detector):
    """A detector that is not part of mavfi."""

    states = None

    def start(self):
        pass

    def check(self, state, now):
        return None

    accept = check


@pytest.fixture
def short(monkeypatch):
    monkeypatch.setattr(module, "LIMIT_S", 0.1)


def spin():
    while True:
        pass


def sleep():
    time.sleep(1e4)


def handle():
    try:
        spin()
    except Exception:
        return "handled"


@pytest.mark.parametrize("call", [spin, sleep, handle])
def test_what_does_not_return_is_stopped(short, call):
    with pytest.raises(StuckError):
        bounded(call)()


@pytest.mark.parametrize("call", [lambda n: n, lambda n: 1 / n])
def test_signals_and_timers_are_those_of_before(call):
    def mine(number, frame):
        raise AssertionError

    before = signal.signal(signal.SIGALRM, mine)
    try:
        signal.setitimer(signal.ITIMER_REAL, 100.0, 7.0)
        for n in (3, 0):
            try:
                assert bounded(call)(n) == call(n)
            except ZeroDivisionError:
                pass
        assert signal.getsignal(signal.SIGALRM) is mine
        left, interval = signal.setitimer(signal.ITIMER_REAL, 0.0)
        assert 90.0 < left <= 100.0 and interval == 7.0
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def test_nothing_is_stopped_after_the_call(short):
    assert bounded(lambda: 5)() == 5
    time.sleep(0.2)


def test_another_thread_has_no_limit(short):
    found = []
    thread = threading.Thread(target=bounded(lambda: found.append(time.sleep(0.3))))
    thread.start()
    thread.join()
    assert found == [None]


@pytest.mark.parametrize(
    ("detector", "has"), [(NoDetector(), False), (Own(), True), (replicated(Own(), 2), True), (Chain(Own()), True)]
)
def test_detectors_have_a_limit_if_a_part_is_foreign(monkeypatch, detector, has):
    found = []
    monkeypatch.setattr(module, "bounded", lambda call: found.append(call) or call)
    assert limited(detector, "check")(new_state("control.command"), 0) is None
    assert bool(found) == has
    assert limited(Own(), "seal") is None and limited(SimpleNamespace(seal=None), "seal") is None


def test_a_method_that_is_replaced_later_is_called():
    own = Own()
    check = limited(own, "check")
    own.check = lambda state, now: now
    assert check(None, 7) == 7


HANGING = """
from numba import njit
from mavfi.detectors import bounded as module

@njit
def spin(number):
    while number > 0:
        number ^= 2
    return number

def check():
    return spin(1)

spin(0)
module.LONGEST_S = 0.4
module.bounded(lambda: 5)()
module.bounded(check)()
"""


def test_compiled_code_that_does_not_return_ends_the_process_and_names_its_caller():
    done = subprocess.run([sys.executable, "-c", HANGING], capture_output=True, text=True, timeout=60)
    assert done.returncode == -signal.SIGVTALRM
    assert "in check" in done.stderr


def die(number):
    os.kill(os.getpid(), number)


def lock_twice():
    """Waits for ever in compiled code, and takes no processor time."""
    mutex = ctypes.create_string_buffer(64)
    lock = ctypes.PyDLL(None).pthread_mutex_lock
    lock(mutex)
    lock(mutex)


def nothing():
    pass


def calls(*functions):
    """What became of each call, one after the other."""
    found = []
    for call in functions:
        try:
            bounded(call)()
        except StuckError as error:
            found.append(error.died or "stuck")
        else:
            found.append("returned")
    return " ".join(found)


def again(work, timeout=60.0):
    """How the last of the children ended in which `work` was called."""
    point = ForkPoint()
    with point.guard():
        ended = split_again(point, timeout)
        if ended is None:
            point.finish(work().encode())
    return ended


@pytest.fixture
def soon(monkeypatch):
    """Processes are ended long before a call of Python is stopped."""
    monkeypatch.setattr(module, "LONGEST_S", 0.3)


@pytest.mark.parametrize(
    ("call", "why"),
    [
        (lambda: die(signal.SIGSEGV), "SIGSEGV"),
        (lambda: os._exit(3), "status 3"),
        (lambda: os._exit(0), "status 0"),
        (lock_twice, "stuck"),
    ],
)
def test_a_child_that_ends_in_a_call_is_repeated_without_it(soon, call, why):
    ended = again(lambda: calls(nothing, call, nothing, call))
    assert ended == Ended("done", f"returned {why} returned {why}".encode())


def test_what_is_stopped_in_time_is_not_repeated(short, tmp_path):
    def work():
        (tmp_path / str(os.getpid())).touch()
        return calls(spin, nothing)

    assert again(work) == Ended("done", b"stuck returned")
    assert len(list(tmp_path.iterdir())) == 1


def segmentation_fault():
    ctypes.string_at(0)


def test_the_line_that_does_not_return_or_crashes_is_written(soon, capfd):
    again(lambda: calls(nothing, lock_twice, segmentation_fault, lambda: os._exit(3)))
    first, second, third = capfd.readouterr().err.splitlines()
    line = lock_twice.__code__.co_firstlineno + 5
    rest = "; the flight is repeated without that call"
    where = f"(test_bounded.py:{line}, lock_twice)"
    assert first == f"mavfi: a call of a detector did not return within 0.3 s {where}{rest}"
    where = f"(test_bounded.py:{segmentation_fault.__code__.co_firstlineno + 1}, segmentation_fault)"
    assert second == f"mavfi: a call of a detector ended its process, SIGSEGV {where}{rest}"
    assert third == f"mavfi: a call of a detector ended its process, status 3{rest}"


def test_a_child_that_ends_between_calls_is_not_repeated():
    def work():
        calls(nothing)
        os._exit(3)

    assert again(work).detail == "ended with status 3 without a report"


def test_a_call_that_raises_is_no_end_of_the_process():
    def work():
        bounded(lambda: 1 / 0)()
        return ""

    assert again(work) == Ended("exception", detail="ZeroDivisionError: division by zero")


def test_a_child_out_of_time_is_not_repeated_for_a_call_that_is_not_overdue():
    assert again(lambda: calls(sleep), timeout=0.3) == Ended("hang", detail=WALL_CLOCK)


def test_each_process_counts_its_own_calls(soon):
    """Two children of one child, forked after different calls, and that itself."""

    def grandchild(*functions):
        return again(lambda: calls(*functions)).payload.decode()

    def work():
        crash = lambda: die(signal.SIGSEGV)  # noqa: E731
        own = calls(nothing, crash, nothing)
        first = grandchild(nothing, nothing, crash)
        own += f", {calls(nothing, crash)}"
        return f"{own} | {first} | {grandchild(crash, nothing, nothing, nothing, nothing)}"

    expected = "returned SIGSEGV returned, returned SIGSEGV"
    expected += " | returned returned SIGSEGV | SIGSEGV returned returned returned returned"
    assert again(work).payload.decode() == expected
