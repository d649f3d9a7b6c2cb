"""The time limit on calls of detectors: it stops what does not return, and leaves signals and timers as they were."""

import signal
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import pytest

from mavfi.detectors import bounded as module
from mavfi.detectors.bounded import StuckError, bounded, limited
from mavfi.detectors.chain import Chain
from mavfi.detectors.registry import NoDetector
from mavfi.detectors.replicas import replicated
from mavfi.states import new_state


class Own:
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
module.LIMIT_S = 0.2
module.bounded(lambda: 5)()
module.bounded(check)()
"""


def test_compiled_code_that_does_not_return_ends_the_process_and_names_its_caller():
    done = subprocess.run([sys.executable, "-c", HANGING], capture_output=True, text=True, timeout=60)
    assert done.returncode == -signal.SIGVTALRM
    assert "in check" in done.stderr
