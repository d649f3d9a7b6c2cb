"""`mavfi states`: the table of inter-kernel states."""

from typing import Annotated, Any

import typer
from rich import box
from rich.table import Table

from mavfi.cli.console import JSON_HELP, console, write_json
from mavfi.errors import BadInputError
from mavfi.states import MONITORED_SETS, ODOMETRY, STACKS, Field, StateSpec, states_with

_DEFAULT_SET = "paper-13"


def states(
    stack: Annotated[
        str, typer.Option(help="Stack whose dead fields are marked: published or hardened.")
    ] = "published",
    monitored: Annotated[
        str, typer.Option(help="Set of fields that detectors watch: paper-13 or published-19.")
    ] = _DEFAULT_SET,
    localization: Annotated[str, typer.Option(help="Whose states are shown: truth or estimator.")] = "truth",
    as_json: Annotated[bool, typer.Option("--json", help=JSON_HELP)] = False,
) -> None:
    """Print every value that one kernel hands to another: what can be struck, and what is watched.

    Example: [bold]mavfi states --stack hardened[/bold]
    """
    if stack not in STACKS:
        raise BadInputError(f"--stack: {stack!r}: allowed: {', '.join(STACKS)}")
    if monitored not in MONITORED_SETS:
        raise BadInputError(f"--monitored: {monitored!r}: allowed: {', '.join(MONITORED_SETS)}")
    if localization not in ODOMETRY:
        raise BadInputError(f"--localization: {localization!r}: allowed: {', '.join(ODOMETRY)}")
    rows = [_state(spec, stack, monitored) for spec in states_with(localization).values()]
    if as_json:
        write_json({"stack": stack, "localization": localization, "monitored_set": monitored, "states": rows})
        return
    console().print(_table(rows, stack, monitored))


def _state(spec: StateSpec, stack: str, monitored: str) -> dict[str, Any]:
    watched = {field for state, field in MONITORED_SETS[monitored] if state == spec.name}
    elements = [_field(field, spec.element, stack, set()) for field in spec.elements]
    header = [_field(field, "", stack, watched) for field in spec.header]
    return {
        "state": spec.name, "writer": spec.writer, "stage": spec.stage.value, "rate": spec.rate,
        "acted_on_when_grows": spec.acted_on, "only_with_localization": spec.only_with, "fields": elements + header,
    }  # fmt: skip


def _field(field: Field, element: str, stack: str, watched: set[str]) -> dict[str, Any]:
    return {
        "field": field.name, "of_each": element, "dtype": field.dtype, "unit": field.unit,
        "monitored": field.name in watched, "dead": field.dead_in(stack),
    }  # fmt: skip


def _table(rows: list[dict[str, Any]], stack: str, monitored: str) -> Table:
    count = sum(len(row["fields"]) for row in rows)
    table = Table(
        title=f"Inter-kernel states · stack {stack}", box=box.SIMPLE_HEAD, title_style="bold", pad_edge=False,
        caption=f"{len(rows)} states, {count} fields. ● watched by detectors ({monitored}). "
        f"dead = no consumer reads it in {stack}. f8, f4 = binary64, binary32; i4 = int32; ? = flag.",
        caption_justify="left",
    )  # fmt: skip
    for heading in ("state", "field", "type", "unit", "watched", "", "writer · stage · rate"):
        table.add_column(heading, justify="center" if heading == "watched" else "left", overflow="fold")
    for row in rows:
        about = [f"{row['writer']} · {row['stage']}", row["rate"]]
        if row["acted_on_when_grows"]:
            about.append(f"acted on when {row['acted_on_when_grows']} grows")
        if row["only_with_localization"]:
            about.append(f"only with localization {row['only_with_localization']}")
        for place, field in enumerate(row["fields"]):
            each = f"[dim]\\[{field['of_each']}][/dim]" if field["of_each"] else ""
            table.add_row(
                f"[bold]{row['state']}[/bold]" if place == 0 else "", field["field"] + each, field["dtype"],
                field["unit"], "●" if field["monitored"] else "", "[dim]dead[/dim]" if field["dead"] else "",
                f"[dim]{about[place]}[/dim]" if place < len(about) else "",
            )  # fmt: skip
        table.add_section()
    return table
