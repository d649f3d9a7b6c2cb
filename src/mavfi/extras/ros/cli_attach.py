"""`mavfi ros corrupt | watch`: inject into and monitor any running ROS 1 application."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer
from rich.markup import escape

from mavfi.cli import options
from mavfi.cli.console import check_name, check_number, check_seed, console, write_json
from mavfi.cli.stopping import stoppable
from mavfi.errors import BadInputError, MavfiError

if TYPE_CHECKING:
    from mavfi.detectors.detector import Detector
    from mavfi.extras.ros.node.injector import MessageInjector
    from mavfi.extras.ros.node.relay import Relay
    from mavfi.extras.ros.node.watch import TopicListener
    from mavfi.faults.levels.message.definition import Definition
    from mavfi.flight.log_readers import Probe
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
        from mavfi.extras.ros.nodes import pid_of_node

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


def watch(  # noqa: PLR0913 - one parameter per option
    topics: Annotated[str, typer.Option(metavar="TOPIC,...", help="What is watched.")],
    fields: Annotated[
        str, typer.Option(metavar="FIELD,...", help="Numbers, e.g. position\\[0], or TOPIC:FIELD; all by default.")
    ] = "",
    detector: Annotated[str, typer.Option(help=f"{options.DETECTORS}, or package:Class.")] = "gaussian",
    profile: options.WatchProfile = "tuned",
    train: Annotated[
        str, typer.Option(metavar="FILE.bag|online", help="A ROS 1 bag of normal messages, or what comes first.")
    ] = "online",
    learn_s: Annotated[float, typer.Option("--learn", help="How long to learn online, s.")] = 10.0,
    duration: options.Duration = None,
    as_json: options.AsJson = False,
) -> None:
    r"""Monitor numeric fields of any topics with one of the paper's detectors; alarms are printed and published.

    They are published on /mavfi/alarm, as JSON text.

    Example: [bold]mavfi ros watch --topics /joint_states --fields 'position\[0]' --train bag.bag[/bold]
    """
    # refuse what cannot be watched, before anything is read
    from mavfi.detectors.preprocess import PROFILES

    check_number("--learn", learn_s, 0.1, _MAX_DURATION_S)
    check_number("--duration", duration, 0.0, _MAX_DURATION_S)
    check_name("--profile", profile, PROFILES)
    from mavfi.extras.ros.node.master import Master
    from mavfi.extras.ros.node.watch import TopicListener, TopicWatch

    names = options.listed(topics)
    if not names:
        raise BadInputError(f"--topics: {topics!r}: allowed: names, with commas between")
    if duration is None:
        duration = _MAX_DURATION_S
    listener = TopicListener(Master(), names)
    out = console()
    with stoppable("Stopped. The graph is as it was."), listener:
        # learn what is normal
        training = _train_detector(listener, (detector, profile), options.listed(fields), train, learn_s)
        watching = TopicWatch(listener, training.probes, training.detector)
        if not as_json:
            topic_names = ", ".join(sorted(training.probes))
            out.print(f"learned from {training.messages} messages; watching {topic_names}", markup=False)

        # judge each message
        try:
            for topic, message in listener.take(duration):
                alarm = watching.judge(topic, message)
                if alarm is not None and not as_json:
                    fields_and_values = zip(alarm.fields, alarm.values, strict=False)
                    values = ", ".join(f"{field} = {value}" for field, value in fields_and_values)
                    out.print(f"{topic} message {alarm.message}: {values}, score {alarm.score:.3g}", markup=False)
        finally:
            if as_json:
                write_json(
                    {
                        "learned_from": training.messages,
                        "judged": dict(watching.judged),
                        "skipped": dict(watching.skipped),
                        "alarms": [alarm.to_json() for alarm in watching.alarms],
                    }
                )
    if not as_json:
        out.print(f"{watching.judged.total()} messages judged, {len(watching.alarms)} alarms")


class MonitorTraining(NamedTuple):
    """A detector trained on messages.

    Attributes:
        probes: The monitored fields, by topic.
        detector: Trained on them.
        messages: Number of training messages.
    """

    probes: dict[str, Probe]
    detector: Detector
    messages: int


def _train_detector(
    listener: TopicListener, detector_and_profile: tuple[str, str], fields: list[str], source: str, seconds: float
) -> MonitorTraining:
    """Train a detector on what the topics publish now, or on a file."""
    from mavfi.detectors.registry import of_monitored_fields
    from mavfi.extras.ros.node.watch import train
    from mavfi.flight.log_readers import make_probes

    check_name("--detector", detector_and_profile[0], of_monitored_fields())
    if source == "online":
        probes = make_probes(listener.first(), fields)
        return MonitorTraining(probes, *train(*detector_and_profile, probes, listener.take(seconds)))
    return trained_on_file(Path(source), listener.topics, listener.definitions, detector_and_profile, fields)


def trained_on_file(
    source: Path,
    topics: Sequence[str],
    definitions: Mapping[str, Definition],
    detector_and_profile: tuple[str, str],
    fields: list[str],
) -> MonitorTraining:
    """Train a detector on the messages of a file.

    Raises:
        BadInputError: The file cannot be read, lacks a topic, has another type for it, or has an invalid message.
    """
    from mavfi.extras.ros.node.watch import train
    from mavfi.flight.log_readers import make_probes, open_flight_log

    try:
        messages = list(open_flight_log(source).messages(topics))
        first = {message.topic: (message.layout, message.data) for message in reversed(messages)}
        for topic, definition in definitions.items():
            if topic in first and definition != first[topic][0]:
                raise BadInputError(f"{topic} has another type there than now ({definition.kind})")
        probes = make_probes(first, fields)
        parts = ((message.topic, message.data) for message in messages)
        return MonitorTraining(probes, *train(*detector_and_profile, probes, parts))
    except MavfiError as error:
        raise BadInputError(f"{source}: {str(error).removeprefix(f'{source}: ')}") from None
