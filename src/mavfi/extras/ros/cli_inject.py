"""`mavfi ros inject | run`: faults in the messages of a running ROS graph, or of one that is started.

Also the option of `mavfi inject` that names a node.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mavfi.cli import options
from mavfi.cli.console import check_number, check_seed, console, counted, write_json
from mavfi.cli.stopping import stoppable
from mavfi.errors import BadInputError

if TYPE_CHECKING:
    from mavfi.extras.ros.ros2.injection import GraphInjection, RunningGraphInjection
    from mavfi.extras.ros.ros2.interposer.page import InterposedFault
    from mavfi.faults.changes import Change

_MAX_DURATION_S = 7 * 86_400.0
_POLL_S = 0.02
_EXIT_NOT_INJECTED = 3
"""Exit code if no message could be changed."""
_SHOWN_REFUSALS = 3
"""As many as a process reports of a fault."""
_AFTERWARDS_S = 1.0
"""How long the graph is watched after the last injection (s)."""


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
        from mavfi.extras.ros.ros2.survey import pid_of_node

        return pid_of_node(values["ros_node"])


def inject(  # noqa: PLR0913 - one parameter per option
    topic: Annotated[str, typer.Option(help="Whose messages are changed.")] = "",
    service: Annotated[str, typer.Option(help="Whose calls are changed, instead of --topic.")] = "",
    side: Annotated[
        str,
        typer.Option(help="publish or take of a topic: in the sender or a reader; request or response of a service."),
    ] = "",
    node: Annotated[str, typer.Option(help="Only in the process of this node.")] = "",
    field: Annotated[str, typer.Option(help="A number, e.g. linear.x or ranges\\[17]; none: whole messages.")] = "",
    bit: Annotated[int | None, typer.Option(help="Flip this bit; 0 = least significant. Drawn by default.")] = None,
    set_to: Annotated[str | None, typer.Option("--set", help="Set the number: a value, nan, inf.")] = None,
    bias: Annotated[str | None, typer.Option(help="Add this.")] = None,
    scale: Annotated[str | None, typer.Option(help="Multiply by this.")] = None,
    drop: Annotated[bool, typer.Option("--drop", help="The message is lost.")] = False,
    delay: Annotated[str | None, typer.Option(help="It comes later, s.")] = None,
    duplicate: Annotated[bool, typer.Option("--duplicate", help="It comes twice.")] = False,
    freeze: Annotated[
        bool, typer.Option("--freeze", help="The first one, or its number, comes again and again.")
    ] = False,
    reorder: Annotated[int | None, typer.Option(help="It comes after so many others.")] = None,
    at: Annotated[
        str, typer.Option(help="From when on: 10 or 10..12 (s), sim=10, n=100 (the message), linear.x>0.5.")
    ] = "",
    times: Annotated[int | None, typer.Option(help="Messages to change; 0 = without limit, until Ctrl-C.")] = None,
    every: Annotated[int | None, typer.Option(help="Only every n-th message from then on.")] = None,
    share: Annotated[float | None, typer.Option(help="Only with this probability.")] = None,
    duration: options.Duration = None,
    seed: Annotated[int, typer.Option(help="Draws bits, and messages of --share.")] = 0,
    as_json: options.AsJson = False,
) -> None:
    r"""Change messages of a topic or service in a running ROS graph; nothing is restarted or remapped.

    The change is made inside the process that sends or takes the message, by a small library that is loaded into it
    and taken out of its calls at the end.

    Example: [bold]mavfi ros inject --topic /cmd_vel --field linear.x --set nan --at 10[/bold]
    """
    check_seed("--seed", seed)
    check_number("--duration", duration, 0.0, _MAX_DURATION_S)
    if bool(topic) == bool(service):
        raise BadInputError("allowed: --topic NAME or --service NAME, one of them")
    change = _change(
        field,
        at,
        {
            "bit": bit,
            "set": set_to,
            "bias": bias,
            "scale": scale,
            "drop": drop,
            "delay": delay,
            "duplicate": duplicate,
            "freeze": freeze,
            "reorder": reorder,
            "times": times,
            "every": every,
            "share": share,
        },
    )
    from mavfi.extras.ros.ros2.fault_text import side_of
    from mavfi.extras.ros.ros2.graph import absolute

    if service and not side:
        raise BadInputError("--side: allowed with --service: request, response")
    kind = "topic"
    if service:
        kind = "service"
    if duration is None:
        duration = _MAX_DURATION_S
    from mavfi.extras.ros.ros2.interposer.page import InterposedFault

    fault = InterposedFault(absolute(topic or service), field, change, side_of(kind, side), seed)
    _inject(fault, node, duration, as_json=as_json)


def _change(field: str, at: str, options_by_name: dict[str, Any]) -> Change:
    """What is done and when, from options; a flip of a drawn bit by default."""
    from mavfi.faults.changes import parse_change

    parts = []
    for name, value in options_by_name.items():
        if value is True:
            parts.append(name)
        elif value is not None and value is not False:
            parts.append(f"{name}={value}")
    if field and not any(part.partition("=")[0] not in ("times", "every", "share") for part in parts):
        parts.append("flip")
    return parse_change(parts, at)


class _Account:
    """What an injection has led to so far: printed as it comes, or written as JSON at the end."""

    def __init__(self, topic: str, *, as_json: bool) -> None:
        self._topic = topic
        self._as_json = as_json
        self._injections: list[GraphInjection] = []
        self._refusals: list[str] = []
        self._events: list[str] = []
        self.has_lost_target = False

    def add_report(self, report: GraphInjection) -> None:
        """Note a change of a message, or why it was refused."""
        self._say(report_line(report))
        if report.report.kind == "changed":
            self._injections.append(report)
            return
        self._refusals.append(f"message {report.report.message}: {report.report.text}")
        if len(self._refusals) == _SHOWN_REFUSALS:
            self._say("further refusals are not shown; Ctrl-C ends the wait for a message that can be changed")

    def add_event(self, text: str) -> None:
        """Note what became of a process or node."""
        self._events.append(text)
        self._say(text)

    @property
    def has_injected(self) -> bool:
        """Whether a message was changed."""
        return bool(self._injections)

    def close(self, injection: RunningGraphInjection) -> None:
        """Print the sum, or all of it as JSON."""
        if self._as_json:
            write_json(
                {
                    "topic": self._topic,
                    "passed": injection.messages,
                    "changed": injection.changed,
                    "injections": [report.to_injection().to_json() for report in self._injections],
                    "refusals": self._refusals,
                    "aftermath": self._events,
                    "unreachable": injection.unreachable,
                }
            )
            return
        end = "the graph is as it was"
        if self.has_lost_target:
            end = "the process that was to be injected has ended"
        self._say(f"{counted(injection.messages, 'message')} passed, {injection.changed} changed; {end}")

    def _say(self, line: str) -> None:
        if not self._as_json:
            console().print(line, markup=False, soft_wrap=True)


def _inject(fault: InterposedFault, node: str, duration: float, *, as_json: bool) -> None:
    """Inject into the running graph, and report.

    The exit code is 1 if the target ended before an injection, and 3 if no message was changed for another reason.
    """
    from mavfi.extras.ros.ros2.graph import AgentClient
    from mavfi.extras.ros.ros2.injection import RunningGraphInjection

    account = _Account(fault.topic, as_json=as_json)
    with stoppable("Stopped."), AgentClient() as agent:
        injection = RunningGraphInjection(agent, fault, node)
        try:
            with injection:
                for line in injection.unreachable:
                    console(error=True).print(f"not reached: {line}", markup=False)
                _follow(injection, duration, account)
        finally:
            # What was changed since the last look, until the fault was disarmed.
            for report in injection.new_reports():
                account.add_report(report)
            account.close(injection)
    if account.has_lost_target and not account.has_injected:
        raise typer.Exit(1)
    if not account.has_injected:
        raise typer.Exit(_EXIT_NOT_INJECTED)


def _follow(injection: RunningGraphInjection, duration: float, account: _Account) -> None:
    """Report injections and what comes of them until the fault is over, and for a moment after it."""
    end = time.monotonic() + duration
    is_over = False
    while time.monotonic() < end:
        for report in injection.new_reports():
            account.add_report(report)
        for event in injection.aftermath():
            account.add_event(event)
        account.has_lost_target = not injection.has_target
        if not is_over and (injection.is_over or account.has_lost_target):
            is_over = True
            end = min(end, time.monotonic() + _AFTERWARDS_S)
        time.sleep(_POLL_S)
    replacement = injection.replacement()
    if replacement:
        account.add_event(replacement)


def _can_never_be(injected: GraphInjection) -> bool:
    """Whether a number was refused that no message of its type has."""
    from mavfi.extras.ros.ros2.message_types import NO_FIELD

    text = injected.report.text
    return injected.report.kind == "refused" and (text.startswith("no member ") or NO_FIELD in text)


def report_line(injected: GraphInjection) -> str:
    """An injection, or why there was none, in one line."""
    report = injected.report
    fault = injected.fault
    where = f"process {report.pid}"
    if injected.node:
        where = f"{injected.node}, process {report.pid}"
    head = f"{fault.topic} message {report.message}"
    instant = f"{report.wall_s - injected.armed_s:.3f} s"
    if report.sim_s:
        instant += f", simulated {report.sim_s:.3f} s"
    if report.kind != "changed":
        return f"{head}: NOT changed: {report.text} ({where}, {instant})"
    what = str(fault.change.operation)
    if fault.field:
        change = f"{report.before!r} → {report.after!r}"
        if report.bit is not None:
            change = f"bit {report.bit}: {change}"
        what = f"{fault.field} ({report.dtype}) {change}"
    proof = ""
    if injected.verified is True:
        proof = ", verified by a second reader"
    elif injected.verified is False:
        proof = ", NOT seen by a second reader"
    return f"{head}: {what} ({where}, {instant}){proof}"


def run(
    command: Annotated[list[str], typer.Argument(metavar="-- COMMAND", help="Starts nodes, e.g. ros2 launch ...")],
    fault: Annotated[
        list[str], typer.Option(metavar="TEXT", help="E.g. 'topic:/scan ranges\\[17] bit=30 @n=100'; repeatable.")
    ],
    seed: Annotated[int, typer.Option(help="Draws bits, and messages of share=.")] = 0,
    as_json: options.AsJson = False,
) -> None:
    r"""Start ROS 2 nodes, also by a launch file, with faults in their messages; the launch file stays as it is.

    Instants count from the start. The exit code is that of the command; 3 if it is 0 and no message was changed.

    Example: [bold]mavfi ros run --fault 'topic:/scan ranges\[17] bit=30 @n=100' -- ros2 launch PACKAGE FILE[/bold]
    """
    check_seed("--seed", seed)
    from mavfi.extras.ros.ros2.started_graph import StartedGraph

    started = StartedGraph(command, fault, seed)
    reports: list[GraphInjection] = []
    with started:
        while True:
            is_over = started.has_ended
            for report in started.new_reports():
                reports.append(report)
                if _can_never_be(report):
                    raise BadInputError(
                        f"fault in {report.fault.topic}: field {report.fault.field}: {report.report.text}"
                    )
                if not as_json:
                    console(error=True).print(report_line(report), markup=False, soft_wrap=True)
            if is_over:
                break
            time.sleep(_POLL_S)
    summary = started.summary()
    if as_json:
        write_json(
            {
                "exit_code": started.exit_code,
                "faults": summary,
                "injections": [report.to_injection().to_json() for report in reports],
            }
        )
    else:
        for line in summary:
            console(error=True).print(line, markup=False, soft_wrap=True)
    exit_code = started.exit_code
    if exit_code == 0 and not any(report.report.kind == "changed" for report in reports):
        exit_code = _EXIT_NOT_INJECTED
    raise typer.Exit(exit_code)
