"""`mavfi ros inject` in a running ROS 1 graph: the readers of a topic are redirected to mavfi, which relays it."""

import time
from dataclasses import replace
from functools import partial

from rich.markup import escape

from mavfi.cli.console import console, write_json
from mavfi.cli.stopping import stoppable
from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.ros.node.injector import MessageInjector, check_fault
from mavfi.extras.ros.node.master import Master
from mavfi.extras.ros.node.relay import Relay
from mavfi.faults.fault import MessageFault
from mavfi.faults.operations import PlannedChange
from mavfi.record import Injection

_AFTERWARDS_S = 0.2
"""Time of relaying after the last injection, so that the corrupted message is delivered (s)."""
_POLL_S = 0.01


def inject_ros1(
    topic: str, field: str, change: PlannedChange, seed: int, node: str, duration: float, *, as_json: bool
) -> None:
    """Inject into a running ROS 1 graph, and report."""
    if change.when.sim_time:
        raise BadInputError("--at: sim=: simulated time; allowed in ROS 1: seconds since the start, or n=NUMBER")
    from_now_on = change._replace(when=replace(change.when, start_s=0.0))
    start_us = round(1e6 * change.when.start_s)
    fault = MessageFault(topic, field, seed=seed, time_us=start_us, change=from_now_on)
    if as_json:
        injector = MessageInjector(fault)
    else:
        injector = MessageInjector(fault, _tell, _tell_refusal)
    relay = Relay(Master(), topic, injector, partial(check_fault, fault), node or None)
    with stoppable("Stopped. The graph is as it was."), relay:
        try:
            _run(relay, injector, duration)
        finally:
            injector.stop()
            if as_json:
                injections = [injection.to_json() for injection in injector.injections]
                write_json(
                    {
                        "topic": relay.topic,
                        "passed": relay.passed,
                        "injections": injections,
                        "refusals": injector.refusals,
                    }
                )
    if not as_json:
        console().print(f"{relay.passed} messages passed, {len(injector.injections)} changed; the graph is as it was")


def _run(relay: Relay, injector: MessageInjector, duration: float) -> None:
    """Relay messages until the fault has been injected, or the duration has elapsed."""
    for failure in relay.failures:
        console(error=True).print(f"not redirected: {failure}", markup=False)
    end = time.monotonic() + duration
    while time.monotonic() < end:
        if relay.error is not None:
            raise MavfiError(f"topic {relay.topic}: {relay.error}")
        if injector.done.wait(_POLL_S):
            break
        time.sleep(_POLL_S)
    injector.stop()
    time.sleep(_AFTERWARDS_S)


def _tell_refusal(refusal: str, *, is_last: bool) -> None:
    """Print that a message was not changed."""
    console().print(f"NOT changed: {refusal}", markup=False, soft_wrap=True)
    if is_last:
        console().print("further refusals are not shown; Ctrl-C ends the wait for a message that can be changed")


def _tell(injection: Injection) -> None:
    """Print one injection in one line."""
    details = injection.details
    verdict = "NOT verified"
    if injection.activated:
        verdict = "verified"
    what = "whole message"
    if details.get("field"):
        what = (
            f"[bold]{escape(details['field'])}[/bold] ({details['kind']}): {injection.before!r} → {injection.after!r}"
        )
    console().print(f"{details['topic']} message {details['message']}: {what}, {details['readers']} readers, {verdict}")
