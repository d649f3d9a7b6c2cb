"""`mavfi ros setup | list | watch`: make a ROS 2 environment, inspect and monitor a running ROS graph."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

from mavfi.cli import options
from mavfi.cli.console import check_number, console, counted, titled_table, write_json

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.table import Table

    from mavfi.extras.ros.survey import Survey, SurveyedNode, SurveyedTopic

_OF_EVERY_NODE = ("rcl_interfaces/", "type_description_interfaces/")
"""Packages of the services that every node of ROS 2 has: of its parameters, of its types, of its logger."""
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
    """Print nodes, processes, topics, types, rates and services of the running ROS graph, of ROS 2 and ROS 1.

    Example: [bold]mavfi ros list[/bold]
    """
    check_number("--seconds", seconds, 0.0, 3600.0)
    from mavfi.extras.ros.survey import survey_all

    surveys = survey_all(seconds)
    if as_json:
        write_json({"graphs": [survey.to_json() for survey in surveys]})
        return
    out = console()
    for survey in surveys:
        out.print(_summary(survey), highlight=False)
        for table in _tables(survey):
            out.print(table)


def _summary(survey: Survey) -> str:
    """What the graph consists of, in one line."""
    parts = [
        counted(len(survey.nodes), "node"),
        counted(len(survey.topics), "topic"),
        counted(len(survey.services), "service"),
        counted(len(survey.actions), "action"),
    ]
    return f"[bold]ROS {survey.ros}[/bold] ({escape(survey.place)}): {', '.join(parts)}"


def _tables(survey: Survey) -> Iterator[Table]:
    """Tables of the nodes, topics, services and actions of a graph."""
    nodes = _table("Nodes", "node", "pid", "program")
    for node in survey.nodes:
        nodes.add_row(escape(node.name), *_process(node))
    yield nodes
    topics = _table("Topics", "topic", "type", "Hz", "publishers", "readers")
    if survey.ros == 2:
        topics = _table("Topics", "topic", "type", "Hz", "QoS", "publishers", "readers")
    for topic in survey.topics:
        if not _is_hidden(topic.name):
            topics.add_row(*_topic_row(survey, topic))
    yield topics
    if survey.actions:
        actions = _table("Actions", "action", "type", "servers")
        for action in survey.actions:
            actions.add_row(action.name, _short(action.kind), "\n".join(action.servers))
        yield actions
    shown = [service for service in survey.services if not _is_hidden(service.name)]
    shown = [service for service in shown if not service.kind.startswith(_OF_EVERY_NODE)]
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


def _topic_row(survey: Survey, topic: SurveyedTopic) -> list[str]:
    rate = ""
    if topic.rate is not None:
        rate = f"{topic.rate:.1f}"
    elif topic.problem:
        rate = "?"
    row = [topic.name, _short(topic.kind), rate]
    if survey.ros == 2:
        row.append(topic.qos)
    return [*row, "\n".join(topic.publishers), "\n".join(topic.readers)]


def _short(kind: str) -> str:
    """Name of a type as in ROS 1, without the folder that ROS 2 has in it."""
    return kind.replace("/msg/", "/").replace("/srv/", "/").replace("/action/", "/")


def _is_hidden(name: str) -> bool:
    """Whether a name is for ROS itself: a part of it begins with an underscore."""
    return "/_" in name
