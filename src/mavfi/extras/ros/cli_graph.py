"""`mavfi ros setup | list | watch`: make a ROS 2 environment, inspect and monitor a running ROS graph."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

from mavfi.cli import options
from mavfi.cli.console import check_name, check_number, console, counted, titled_table, write_json
from mavfi.cli.stopping import stoppable
from mavfi.errors import BadInputError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.table import Table

    from mavfi.extras.ros.ros2.survey import Survey, SurveyedNode, SurveyedService, SurveyedTopic

_MAX_DURATION_S = 7 * 86_400.0
_NUMBERS = ("pid", "Hz")
"""Columns with numbers."""


def setup(
    distributions: Annotated[
        list[str] | None, typer.Argument(metavar="jazzy|kilted", help="One or both; jazzy by default.")
    ] = None,
) -> None:
    """Make an environment with ROS 2 for machines that have none, apart from mavfi's own.

    Nothing is installed where there is a ROS 2 already.

    Example: [bold]mavfi ros setup[/bold]
    """
    from mavfi.extras.ros.ros2.setup import install

    progress = console(error=True)
    out = console()
    for distribution in distributions or ["jazzy"]:
        installation = install(distribution, lambda line: progress.print(line, style="dim", soft_wrap=True))
        out.print(f"ROS 2 {installation.distribution} is here: {installation.prefix}", soft_wrap=True, highlight=False)
    out.print("Next: [bold]mavfi ros list[/bold] shows a running graph.")


def list_graphs(
    seconds: Annotated[float, typer.Option(help="How long to listen for rates, s; 0 = not at all.")] = 1.0,
    as_json: options.AsJson = False,
) -> None:
    """Print nodes, processes, topics, types, rates and services of the running ROS graph.

    Example: [bold]mavfi ros list[/bold]
    """
    check_number("--seconds", seconds, 0.0, 3600.0)
    from mavfi.extras.ros.ros2.survey import survey_graph

    survey = survey_graph(seconds)
    if as_json:
        write_json({"graphs": [survey.to_json()]})
        return
    out = console()
    out.print(_summary(survey), highlight=False)
    for table in _tables(survey):
        out.print(table)


def _summary(survey: Survey) -> str:
    """What the graph consists of, in one line."""
    parts = [
        counted(len(survey.nodes), "node"),
        counted(len(survey.topics), "topic"),
        counted(len(_shown_services(survey)), "service"),
        counted(len(survey.actions), "action"),
    ]
    return f"[bold]ROS 2[/bold] ({escape(survey.address)}): {', '.join(parts)}"


def _shown_services(survey: Survey) -> list[SurveyedService]:
    """Services without those of actions, and those that every node has."""
    from mavfi.extras.ros.ros2.graph import OF_EVERY_NODE

    services = [service for service in survey.services if not _is_hidden(service.name)]
    return [service for service in services if not service.kind.startswith(OF_EVERY_NODE)]


def _tables(survey: Survey) -> Iterator[Table]:
    """Tables of the nodes, topics, services and actions of a graph."""
    nodes = _table("Nodes", "node", "pid", "program")
    for node in survey.nodes:
        nodes.add_row(escape(node.name), *_process(node))
    yield nodes
    topics = _table("Topics", "topic", "type", "Hz", "QoS", "publishers", "readers")
    for topic in survey.topics:
        if not _is_hidden(topic.name):
            topics.add_row(*_topic_row(topic))
    yield topics
    if survey.actions:
        actions = _table("Actions", "action", "type", "servers")
        for action in survey.actions:
            actions.add_row(action.name, _short(action.kind), "\n".join(action.servers))
        yield actions
    shown = _shown_services(survey)
    if shown:
        services = _table("Services", "service", "type", "servers")
        for service in shown:
            services.add_row(service.name, _short(service.kind), "\n".join(service.servers))
        yield services


def _table(title: str, *columns: str) -> Table:
    table = titled_table(title, padding=(0, 1, 0, 0))
    for column in columns:
        if column in _NUMBERS:
            table.add_column(column, justify="right", no_wrap=True)
        else:
            table.add_column(column, overflow="fold")
    return table


def _process(node: SurveyedNode) -> tuple[str, str]:
    """Process id and program of a node; why they are unknown."""
    if node.problem:
        return "[red]?[/red]", f"[dim]{escape(node.problem)}[/dim]"
    return str(node.pid), escape(node.executable)


def _topic_row(topic: SurveyedTopic) -> list[str]:
    rate = ""
    if topic.rate is not None:
        rate = f"{topic.rate:.1f}"
    elif topic.problem:
        rate = "?"
    kind = _short(topic.kind)
    return [topic.name, kind, rate, topic.qos, "\n".join(topic.publishers), "\n".join(topic.readers)]


def _short(kind: str) -> str:
    """Name of a type without its folder: "std_msgs/String" for "std_msgs/msg/String"."""
    return kind.replace("/msg/", "/").replace("/srv/", "/").replace("/action/", "/")


def _is_hidden(name: str) -> bool:
    """Whether a name is for ROS itself: a part of it begins with an underscore."""
    return "/_" in name


def watch(  # noqa: PLR0913 - one parameter per option
    topics: Annotated[str, typer.Option(metavar="TOPIC,...", help="What is watched.")],
    fields: Annotated[
        str, typer.Option(metavar="FIELD,...", help="Numbers, e.g. position\\[0], or TOPIC:FIELD; all by default.")
    ] = "",
    detector: Annotated[
        str,
        typer.Option(help=f"{options.DETECTORS}, or package:Class.", autocompletion=options.complete_detector),
    ] = "gaussian",
    profile: options.WatchProfile = "tuned",
    train: Annotated[
        str, typer.Option(metavar="FILE|FOLDER|online", help="Normal messages: .bag, .mcap, .db3, or what comes first.")
    ] = "online",
    learn_s: Annotated[float, typer.Option("--learn", help="How long to learn online, s.")] = 10.0,
    duration: options.Duration = None,
    as_json: options.AsJson = False,
) -> None:
    r"""Monitor numeric fields of any topics with one of the paper's detectors.

    Alarms are printed, and published on /mavfi/alarm as JSON text.

    Example: [bold]mavfi ros watch --topics /odom,/cmd_vel --train normal.mcap[/bold]
    """
    # refuse what cannot be watched, before anything is read
    from mavfi.detectors.preprocess import PROFILES
    from mavfi.detectors.registry import of_monitored_fields

    check_number("--learn", learn_s, 0.1, _MAX_DURATION_S)
    check_number("--duration", duration, 0.0, _MAX_DURATION_S)
    check_name("--profile", profile, PROFILES)
    check_name("--detector", detector, of_monitored_fields())
    from mavfi.extras.logs.selection import summary
    from mavfi.extras.ros.ros2.environment import find_installation
    from mavfi.extras.ros.ros2.listener import GraphListener
    from mavfi.extras.ros.watch import TopicWatch, train_on_file, train_online

    names = options.listed(topics)
    if not names:
        raise BadInputError(f"--topics: {topics!r}: allowed: names, with commas between")
    if duration is None:
        duration = _MAX_DURATION_S
    listener = GraphListener(find_installation(), names)
    out = console()
    with stoppable("Stopped. The graph is as it was."), listener:
        # learn what is normal
        field_names = options.listed(fields)
        if train == "online":
            trained = train_online(listener, (detector, profile), field_names, learn_s)
        else:
            trained = train_on_file(
                Path(train), listener.topics, listener.definitions, (detector, profile), field_names
            )
        watching = TopicWatch(listener, trained)
        if not as_json:
            topic_names = ", ".join(sorted(trained.selection.topics))
            out.print(f"learned from {trained.trained_on} messages; watching {topic_names}", markup=False)
            for line in summary(trained.selection.not_monitored):
                out.print(line, markup=False)

        # judge each message
        try:
            for topic, message in listener.take(duration):
                alarm = watching.judge(topic, message)
                if alarm is not None and not as_json:
                    fields_and_values = zip(alarm.fields, alarm.values, strict=False)
                    values = ", ".join(f"{field} = {value}" for field, value in fields_and_values)
                    out.print(f"{topic} message {alarm.message}: {values}, score {alarm.score:.3g}", markup=False)
        finally:
            for notice in listener.notices:
                console(error=True).print(notice, markup=False, soft_wrap=True)
            if as_json:
                write_json(
                    {
                        "learned_from": trained.trained_on,
                        "not_monitored": [item._asdict() for item in trained.selection.not_monitored],
                        "judged": dict(watching.judged),
                        "skipped": dict(watching.skipped),
                        "alarms": [alarm.to_json() for alarm in watching.alarms],
                    }
                )
    if not as_json:
        out.print(f"{watching.judged.total()} messages judged, {len(watching.alarms)} alarms")
