"""A detector that never returns blocks no flight: it is disabled, and the flight is that without it."""

import time

import pytest

from mavfi.detectors import bounded
from mavfi.flight_record import STUCK
from mavfi.hosts.local import fly
from mavfi.hosts.local.fast_forward import FastForward
from mavfi.hosts.loop.policy import Recovery
from mavfi.reports.explain import alarm_lines
from tests.hosts.missions import Scripted, fault, golden, mission
from tests.hosts.test_checkpoints import content


class Endless(Scripted):
    """Raises no alarm; from the n-th call of a method on, that never returns."""

    n = 400

    def __init__(self, method):
        super().__init__()
        self.method, self.calls = method, 0

    def start(self):
        super().start()
        self.calls = 0

    def _count(self, method):
        self.calls += method == self.method
        while method == self.method and self.calls >= self.n:
            time.sleep(1.0)

    def check(self, state, time_us):
        self._count("check")
        return super().check(state, time_us)

    def accept(self, state, time_us):
        self._count("accept")


class Sealing(Endless):
    def seal(self, state, time_us):
        self._count("seal")


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setattr(bounded, "LIMIT_S", 0.1)


@pytest.mark.parametrize("method", ["check", "accept", "seal"])
def test_the_flight_goes_on_without_it(method):
    detector = (Sealing if method == "seal" else Endless)(method)
    log = fly(mission(), detector=detector).log
    assert log.digest() == golden().log.digest() and log.alarms == []
    (event,) = (event for event in log.events if event.kind == STUCK)
    assert 0 < event.time_us < 1e6 * 5
    assert detector.calls == detector.n, "it is called no more"
    assert ("alarms", "0 in all") in alarm_lines(log, None)
    assert any("did not return within 60 s" in text for _, text in alarm_lines(log, None))


@pytest.mark.parametrize("make", [lambda: Endless("check"), lambda: Endless("accept"), lambda: Sealing("seal")])
def test_fast_forwarded_flights_are_those_from_take_off(make):
    injected, recovery = fault("control.command", "vx", 4.0, 62), Recovery(same_twice="limit")
    forward = FastForward(mission())
    for one in (None, injected):
        mine = forward.fly(one, make(), "endless", recovery)
        assert content(mine.log) == content(fly(mission(), one, make(), recovery=recovery).log)
