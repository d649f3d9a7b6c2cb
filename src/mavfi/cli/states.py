"""`mavfi states`: the table of inter-kernel states."""

from collections.abc import Collection, Mapping, Sequence
from typing import Annotated

import typer
from rich.console import Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from mavfi.cli.console import check_name, console
from mavfi.states import AUTOPILOTS, MONITORED_SETS, ODOMETRY, Field, StateSpec, states_with

HELP_PANEL = "Fly and look"
_MONITORED = "paper-13"
"""Set of fields that the paper's detectors watch."""
_VEHICLE = "flight controller"
"""Reader of states that no kernel of the pipeline reads, i.e. the command."""


def states(
    autopilot: Annotated[
        str, typer.Option("--autopilot", help="Profile whose dead fields are marked: published or hardened.")
    ] = "published",
    localization: Annotated[str, typer.Option(help="Whose states are shown: truth or estimator.")] = "truth",
) -> None:
    """Print the states between kernels, which faults can hit.

    Of each: its writer and readers, and its injectable and monitored fields.

    Example: [bold]mavfi states --autopilot hardened[/bold]
    """
    check_name("--autopilot", autopilot, AUTOPILOTS)
    check_name("--localization", localization, ODOMETRY)
    readers = _readers(autopilot, localization)
    console().print(_page(states_with(localization).values(), autopilot, readers))


def _readers(autopilot: str, localization: str) -> dict[str, list[str]]:
    """Readers of each state, from a pipeline that is built but not flown."""
    import numpy as np

    from mavfi.flight.compose import pipeline_config, resolve
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


def _page(specs: Collection[StateSpec], autopilot: str, readers: Mapping[str, list[str]]) -> Group:
    """All states with their fields, and what the signs mean."""
    count = sum(len(spec.elements) + len(spec.header) for spec in specs)
    notes = (
        f"{len(specs)} states, {count} fields. ● watched by detectors ({_MONITORED}). "
        f"dead = no consumer reads it in {autopilot}. f8, f4 = binary64, binary32; i4 = int32; ? = flag."
    )
    parts: list[RenderableType] = [Text(f"Inter-kernel states · autopilot {autopilot}", style="bold")]
    for spec in specs:
        heading = _heading(spec, readers.get(spec.name, [_VEHICLE]))
        parts += [Text(), heading, Padding(_fields(spec, autopilot), (0, 0, 0, 2))]
    return Group(*parts, Text(), Text(notes, style="dim"))


def _heading(spec: StateSpec, readers: Sequence[str]) -> Group:
    """Name of a state, its rate, its writer and its readers."""
    about = [spec.rate]
    if spec.acted_on:
        about.append(f"acted on when {spec.acted_on} grows")
    if spec.only_with:
        about.append(f"only with localization {spec.only_with}")
    lines = f"written by {spec.writer}, read by {', '.join(readers)}", "; ".join(about)
    return Group(Text(spec.name, style="bold"), *(Padding(Text(line, style="dim"), (0, 0, 0, 2)) for line in lines))


def _fields(spec: StateSpec, autopilot: str) -> Table:
    """The fields of each element, then those of the header, which detectors may watch."""
    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    for width in (28, 2, 7, 1, 4):
        table.add_column(min_width=width, no_wrap=True)
    monitored = {field for state, field in MONITORED_SETS[_MONITORED] if state == spec.name}
    for field in spec.elements:
        name = Text.assemble(field.name, (f"[{spec.element}]", "dim"))
        table.add_row(name, field.dtype, field.unit, "", _dead_mark(field, autopilot))
    for field in spec.header:
        watched = "●" if field.name in monitored else ""
        table.add_row(Text(field.name), field.dtype, field.unit, watched, _dead_mark(field, autopilot))
    return table


def _dead_mark(field: Field, autopilot: str) -> Text:
    return Text("dead" if field.dead_in(autopilot) else "", style="dim")
