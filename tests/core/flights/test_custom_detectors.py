"""A custom detector that raises after the injection is disabled; one that ends its process costs only its own runs."""

import os
import signal
from functools import cache

import pytest

import mavfi
from mavfi.campaign.config import Campaign
from mavfi.campaign.store import Store
from mavfi.flight.fast_forward import FastForward
from mavfi.flight.fly import fly
from mavfi.flight.known_flights import FlownArm
from mavfi.plugins import allow_typed
from mavfi.record import CRASHED, End
from mavfi.report.explain import alarm_lines
from tests.core.flights.missions import Scripted, fault, mission
from tests.core.flights.test_checkpoints import content


@cache
def commands():
    """Those of the golden flight."""
    command_names = set()

    def note(state, time_us):
        if state.spec.name == "control.command":
            command_names.add(state.header.tobytes())

    fly(mission(), recorders=[note])
    return command_names


class Brittle(Scripted):
    """Cannot cope with commands other than those of the golden flight."""

    known = None

    def check(self, state, time_us):
        known = commands() if self.known is None else self.known
        if state.spec.name == "control.command" and state.header.tobytes() not in known:
            raise ValueError("no such command")


class Broken(Brittle):
    known = frozenset()


class BrittleSeal(Scripted):
    """Its seal fails at the first command that is not one of the golden flight."""

    seals = True

    def seal(self, state, time_us):
        if state.spec.name == "control.command" and state.header.tobytes() not in commands():
            raise ValueError("no such command")


WRONG = fault("control.command", "vx", 8.0, 62)


@pytest.mark.parametrize("detector", [Brittle, BrittleSeal])
@pytest.mark.parametrize("make", [FastForward, None])
def test_an_exception_after_the_injection_disables_it(make, detector):
    flight = (
        fly(mission(), WRONG, detector()) if make is None else make(mission()).fly(WRONG, FlownArm("own", detector()))
    )
    (event,) = (event for event in flight.log.events if event.kind == CRASHED)
    assert event.data == {"how": "ValueError: no such command"}
    if detector is Brittle:  # the seal sees the first command that the fault has changed, not the fault
        assert event.time_us / 1e6 == pytest.approx(flight.log.injections[0].time_s)
    assert content(flight.log)[0] == content(fly(mission(), WRONG).log)[0]
    sentence = f"is disabled from {event.time_us / 1e6:.2f} s on, a call of it crashed: ValueError: no such command"
    assert any(sentence in text for _, text in alarm_lines(flight.log, None))


def test_an_exception_before_it_is_raised():
    for injected in (None, WRONG):
        with pytest.raises(ValueError, match="no such command"):
            fly(mission(), injected, Broken())


# ---- calls that end the process -------------------------------------------------------------------------------------
class Ending(Scripted):
    """Its n-th check ends the process."""

    def __init__(self):
        super().__init__()
        self.checks = 0

    def start(self):
        super().start()
        self.checks = 0

    def check(self, state, time_us):
        self.checks += 1
        if self.checks == 400:
            os.kill(os.getpid(), signal.SIGSEGV)


@pytest.mark.slow
def test_a_campaign_flies_all_other_runs_and_names_the_call(tmp_path):
    name = f"{__name__}:Ending"
    allow_typed([name])
    campaign = Campaign.model_validate(
        {
            "name": "ending",
            "environments": ["sparse"],
            "missions": 1,
            "faults": 1,
            "null_runs": 1,
            "arms": {"own": {"detector": name}},
        }
    )
    mavfi.run(campaign, tmp_path / "runs", workers=1)
    with Store.open(tmp_path / "runs") as store:
        runs = {(run.spec.kind, run.spec.arm): run for run in store.runs()}
    assert len(runs) == 5
    assert {run.record.end for (_, arm), run in runs.items() if not arm} == {End.FLOWN}
    for (_, arm), run in runs.items():
        if arm:
            assert run.record.end is End.UNKNOWN
            assert f"detector {name}: check ended its process (SIGSEGV)" in run.note
