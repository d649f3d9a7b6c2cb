"""`mavfi states`: the table of inter-kernel states."""

from collections.abc import Mapping
from typing import Annotated, Any

import typer
from rich.console import Group
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from mavfi.cli import options
from mavfi.cli.console import check_name, console, write_json
from mavfi.states import AUTOPILOTS, MONITORED_SETS, ODOMETRY, Field, StateSpec, states_with

_DEFAULT_SET = "paper-13"
_VEHICLE = "flight controller"
"""Reader of states that no kernel of the pipeline reads, i.e. the command."""


def states(
    autopilot: Annotated[
        str, typer.Option("--autopilot", help="Profile whose dead fields are marked: published or hardened.")
    ] = "published",
    monitored: Annotated[
        str, typer.Option(help="Set of fields that detectors watch: paper-13 or published-19.")
    ] = _DEFAULT_SET,
    localization: Annotated[str, typer.Option(help="Whose states are shown: truth or estimator.")] = "truth",
    as_json: options.AsJson = False,
) -> None:
    """Print every inter-kernel state: its writer and readers, and its injectable and monitored fields.

    Example: [bold]mavfi states --autopilot hardened[/bold]
    """
    check_name("--autopilot", autopilot, AUTOPILOTS)
    check_name("--monitored", monitored, MONITORED_SETS)
    check_name("--localization", localization, ODOMETRY)
    readers = _readers(autopilot, localization)
    rows = [_state(spec, autopilot, monitored, readers) for spec in states_with(localization).values()]
    if as_json:
        data = {"autopilot": autopilot, "localization": localization, "monitored_set": monitored, "states": rows}
        write_json(data)
        return
    console().print(_page(rows, autopilot, monitored))


def _readers(autopilot: str, localization: str) -> dict[str, list[str]]:
    """Readers of each state, from a pipeline that is built but not flown."""
    import numpy as np

    from mavfi.hosts.loop.compose import pipeline_config, resolve
    from mavfi.mission import MissionSpec
    from mavfi.pipeline.ppc import build_pipeline
    from mavfi.sim.environments import build_world

    scenario = resolve(MissionSpec.model_validate({"autopilot": autopilot, "localization": localization}))
    world = build_world(scenario.environment, scenario.seed, scenario.start, scenario.goal)
    readers: dict[str, list[str]] = {}
    for name, kernel in build_pipeline(pipeline_config(scenario, world, np.zeros((1, 3)))).items():
        for state in kernel.reads:
            readers.setdefault(state, []).append(name)
    return readers


def _state(spec: StateSpec, autopilot: str, monitored: str, readers: Mapping[str, list[str]]) -> dict[str, Any]:
    watched = {field for state, field in MONITORED_SETS[monitored] if state == spec.name}
    elements = [_field(field, spec.element, autopilot, set()) for field in spec.elements]
    header = [_field(field, "", autopilot, watched) for field in spec.header]
    return {
        "state": spec.name, "stage": spec.stage.value, "writer": spec.writer,
        "readers": readers.get(spec.name, [_VEHICLE]), "rate": spec.rate, "acted_on_when_grows": spec.acted_on,
        "only_with_localization": spec.only_with, "fields": elements + header,
    }  # fmt: skip


def _field(field: Field, element: str, autopilot: str, watched: set[str]) -> dict[str, Any]:
    return {
        "field": field.name, "of_each": element, "dtype": field.dtype, "unit": field.unit,
        "monitored": field.name in watched, "dead": field.dead_in(autopilot),
    }  # fmt: skip


def _page(rows: list[dict[str, Any]], autopilot: str, monitored: str) -> Group:
    count = sum(len(row["fields"]) for row in rows)
    notes = (
        f"{len(rows)} states, {count} fields. ● watched by detectors ({monitored}). "
        f"dead = no consumer reads it in {autopilot}. f8, f4 = binary64, binary32; i4 = int32; ? = flag."
    )
    title = Text(f"Inter-kernel states · autopilot {autopilot}", style="bold")
    parts = [part for row in rows for part in (Text(), _heading(row), Padding(_fields(row["fields"]), (0, 0, 0, 2)))]
    return Group(title, *parts, Text(), Text(notes, style="dim"))


def _heading(row: dict[str, Any]) -> Group:
    about = [row["rate"]]
    if row["acted_on_when_grows"]:
        about.append(f"acted on when {row['acted_on_when_grows']} grows")
    if row["only_with_localization"]:
        about.append(f"only with localization {row['only_with_localization']}")
    lines = f"written by {row['writer']}, read by {', '.join(row['readers'])}", "; ".join(about)
    return Group(Text(row["state"], style="bold"), *(Padding(Text(line, style="dim"), (0, 0, 0, 2)) for line in lines))


def _fields(fields: list[dict[str, Any]]) -> Table:
    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    for width in (28, 2, 7, 1, 4):
        table.add_column(min_width=width, no_wrap=True)
    for field in fields:
        each = f"[{field['of_each']}]" if field["of_each"] else ""
        table.add_row(
            Text.assemble(field["field"], (each, "dim")), field["dtype"], field["unit"],
            "●" if field["monitored"] else "", Text("dead" if field["dead"] else "", style="dim"),
        )  # fmt: skip
    return table
