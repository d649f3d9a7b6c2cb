"""`mavfi ros corrupt`: inject into any running ROS 1 application."""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape

from mavfi.cli import options
from mavfi.cli.console import check_number, check_seed, console, write_json
from mavfi.cli.stopping import stoppable
from mavfi.errors import MavfiError

if TYPE_CHECKING:
    from mavfi.extras.ros.node.injector import MessageInjector
    from mavfi.extras.ros.node.relay import Relay
    from mavfi.record import Injection

_MAX_DURATION_S = 7 * 86_400.0
_AFTERWARDS_S = 0.2
"""Time of relaying after the last injection, so that the corrupted message is delivered (s)."""
_POLL_S = 0.01


class RosNode:
    """The option of `mavfi inject` that names a ROS node instead of a process."""

    options = {
        "ros_node": Annotated[
            str | None, typer.Option(metavar="NAME", help="The ROS node to inject, instead of --pid.")
        ]
    }

    @staticmethod
    def pid_of(values: dict[str, Any]) -> int | None:
        """See `mavfi.extras.registers.cli.PROCESSES`."""
        if values["ros_node"] is None:
            return None
        from mavfi.extras.ros.survey import pid_of_node

        return pid_of_node(values["ros_node"])


def corrupt(  # noqa: PLR0913 - one parameter per option
    topic: Annotated[str, typer.Option(help="Whose messages are changed.")],
    field: Annotated[str, typer.Option(help="A number in them, e.g. position\\[0] or pose.position.x.")],
    bit: Annotated[int | None, typer.Option(help="0 = least significant; drawn by default.")] = None,
    at: Annotated[int, typer.Option(help="First message that may be changed, counted from 1.")] = 1,
    rate: Annotated[
        float | None, typer.Option(help="Change each message with this probability, until Ctrl-C; one by default.")
    ] = None,
    node: Annotated[str | None, typer.Option(help="Only this reader gets changed messages.")] = None,
    duration: Annotated[float | None, typer.Option(help="Stop after this time, s.")] = None,
    seed: Annotated[int, typer.Option(help="Draws messages and bits.")] = 0,
    as_json: options.AsJson = False,
) -> None:
    r"""Flip bits of a numeric field in the messages of any topic, without restarting any node.

    Subscribers are redirected to mavfi, and back to their publishers at the end, even if mavfi is killed.

    Example: [bold]mavfi ros corrupt --topic /joint_states --field 'position\[0]' --bit 51 --at 10[/bold]
    """
    check_seed("--seed", seed)
    check_number("--duration", duration, 0.0, _MAX_DURATION_S)
    from mavfi.extras.ros.node.injector import MessageInjector, check_fault
    from mavfi.extras.ros.node.master import Master
    from mavfi.extras.ros.node.relay import Relay
    from mavfi.faults.fault import MessageFault

    fault = MessageFault(topic, field, bit, at, rate, seed=seed)
    tell = None
    if not as_json:
        tell = _tell
    injector = MessageInjector(fault, tell)
    relay = Relay(Master(), topic, injector, partial(check_fault, fault), node)
    with stoppable("Stopped. The graph is as it was."), relay:
        try:
            _run(relay, injector, duration)
        finally:
            injector.stop()
            if as_json:
                injections = [injection.to_json() for injection in injector.injections]
                write_json({"topic": relay.topic, "passed": relay.passed, "injections": injections})
    if not as_json:
        console().print(f"{relay.passed} messages passed, {len(injector.injections)} injected; the graph is as it was")


def _run(relay: Relay, injector: MessageInjector, duration: float | None) -> None:
    """Relay messages until the fault has been injected, or the duration has elapsed."""
    for failure in relay.failures:
        console(error=True).print(f"not turned: {failure}", markup=False)
    if duration is None:
        duration = _MAX_DURATION_S
    end = time.monotonic() + duration
    while time.monotonic() < end:
        if relay.error is not None:
            raise MavfiError(f"topic {relay.topic}: {relay.error}")
        if injector.fault.rate is None and injector.done.wait(_POLL_S):
            break
        time.sleep(_POLL_S)
    injector.stop()
    time.sleep(_AFTERWARDS_S)


def _tell(injection: Injection) -> None:
    """Print one injection in one line."""
    details = injection.details
    verdict = "NOT verified"
    if injection.activated:
        verdict = "verified"
    console().print(
        f"{details['topic']} message {details['message']}: [bold]{escape(details['field'])}[/bold] "
        f"({details['kind']}) bit {injection.bit}: {injection.before!r} → {injection.after!r}, "
        f"{details['readers']} readers, {verdict}"
    )
