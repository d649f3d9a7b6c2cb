"""The time limit on calls of detectors: it stops what does not return, and leaves signals and timers as they were."""

import signal
import threading
import time
from types import SimpleNamespace

import pytest

from mavfi.detectors import bounded as module
from mavfi.detectors.bounded import StuckError, bounded, limited
from mavfi.detectors.registry import NoDetector
from mavfi.detectors.replicas import replicated


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


def test_detectors_of_mavfi_have_no_limit_unless_a_part_is_foreign():
    own, shipped = Own(), NoDetector()
    assert limited(shipped, "check") == shipped.check
    assert limited(own, "check") != own.check
    pair = replicated(own, 2)
    assert type(pair).__module__.startswith("mavfi.") and limited(pair, "check") != pair.check
    assert limited(own, "seal") is None and limited(SimpleNamespace(seal=None), "seal") is None
