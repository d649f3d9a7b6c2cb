"""Options shared by several commands.  Mission options are derived from `MissionSpec`: one option per field."""

import functools
import inspect
import math
from collections.abc import Callable, Collection, Mapping
from copy import copy
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

import typer
from pydantic import ValidationError
from pydantic.fields import FieldInfo

from mavfi.cli import completion
from mavfi.cli.panels import DETECTION, FAULT, MISSION, OF_OPTIONS, OUTPUT, PIPELINE
from mavfi.config import Vector
from mavfi.errors import BadInputError, not_known
from mavfi.mission import LARGEST_SEED, OF_A_DETECTOR, MissionSpec
from mavfi.plugins import extensions, known

_PANEL_OF = {
    **dict.fromkeys(
        ("environment", "seed", "start", "goal", "v_max", "wind", "arrival_radius", "time_limit_factor"), MISSION
    ),
    **dict.fromkeys(("faults", "fault", "fault_seed", "dead_node", "protection"), FAULT),
    **dict.fromkeys(("detector", "profile", "models", *OF_A_DETECTOR), DETECTION),
    **dict.fromkeys(("as_json", "save", "picture", "html", "pace"), OUTPUT),
}
"""Panels by parameter, in the order of the help; all other fields of missions are of the pipeline."""

_COMPLETERS = {
    "environment": completion.of_configs("environments"),
    "autopilot": completion.of_configs("autopilots"),
    "planner": completion.of_configs("planners"),
    "platform": completion.of_configs("platforms"),
    "vehicle": completion.of_configs("vehicles"),
    "protection": completion.of_configs("protections"),
    "map": completion.of_entry_points("mavfi.maps"),
    "flight_controller": completion.of_entry_points("mavfi.flight_controllers"),
    "trained_for": completion.trained_for,
}
"""What completes the values of fields of missions; words of others are known from their type."""

FORMS = "with bits, instants and more: see fault-specs.md in the documentation."
Faults = Annotated[
    list[str] | None,
    typer.Option(
        "--fault",
        metavar="SPEC",
        help="state:PLACE, memory:PLACE, instruction:KERNEL, sensor:UNIT:TYPE, message:STATE:OPERATION, or null, "
        f"{FORMS} Several times: all in one mission.",
        show_default=False,
        autocompletion=completion.fault,
    ),
]
FaultSeed = Annotated[
    int | None,
    typer.Option(help="Draws instant, element, bit, ... that --fault does not name; 0 by default."),
]
DETECTORS = ", ".join(sorted(known("mavfi.detectors", {})))
"""Names of entry points; importing the registry, which loads them, would slow down `--help`."""
complete_detector = completion.of_entry_points("mavfi.detectors", "none")
Detector = Annotated[str, typer.Option(help=f"{DETECTORS}, or package:Class.", autocompletion=complete_detector)]
Profile = Annotated[
    str | None,
    typer.Option(
        help="Of the detector: paper (default) or tuned.", autocompletion=completion.of_words(("paper", "tuned"))
    ),
]
WatchProfile = Annotated[str, typer.Option(help="paper (signs and exponents of values) or tuned (of changes).")]
"""Of detectors of foreign messages."""
Duration = Annotated[float | None, typer.Option(help="Duration, s; until Ctrl-C by default.")]
Models = Annotated[Path | None, typer.Option(help="Folder of trained models; shipped ones by default.")]
AsJson = Annotated[bool, typer.Option("--json", help="One JSON object instead of text.")]
Save = Annotated[Path | None, typer.Option(metavar="FILE.npz", help="Write the whole record of the flight.")]
Picture = Annotated[Path | None, typer.Option(metavar="FILE.png", help="Draw the flight from above and from the side.")]
Html = Annotated[
    Path | None,
    typer.Option(metavar="FILE.html", help="Write a page with the flight in 3-D, its time lines, the story."),
]
Ledger = Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the ledger.")]
RunId = Annotated[
    str,
    typer.Argument(
        metavar="RUN",
        help="Its number in `mavfi runs DIR`, or the beginning of its id.",
        autocompletion=completion.run_id,
    ),
]
Require = Annotated[
    list[str] | None,
    typer.Option(
        metavar="TEXT",
        help="Exit code 3 unless intervals show it: 'sdc < 5 %', 'recommended: success >= 95 %', "
        "'fi.lost - recommended.lost > 2 %' (of two campaigns: A.lost - B.lost); repeatable.",
    ),
]
AllTables = Annotated[bool, typer.Option("--all", help="Print all tables, not only the headline.")]
Workers = Annotated[int, typer.Option(help="Processes; the result does not depend on them.")]


def with_mission_options(verb: Callable[..., None], without: Collection[str] = ()) -> Callable[..., None]:
    """Replace a command's first parameter, a `MissionSpec`, by one option for each field except `without`.

    Only the fields of options that the user has set are set.  An invalid value raises `BadInputError`.
    """
    fields = {name: field for name, field in MissionSpec.model_fields.items() if name not in without}
    # the command's other parameters; Typer needs the context among them, from which `wrapped` knows what was set
    others = {
        name: parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)
        for name, parameter in list(inspect.signature(verb, eval_str=True).parameters.items())[1:]
    }
    passes_context = "context" in others
    others["context"] = inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)

    @functools.wraps(verb)
    def wrapped(context: typer.Context, **values: Any) -> None:
        mission_values = {name: values.pop(name) for name in fields}
        set_by_user = {
            name: value for name, value in mission_values.items() if is_users(context.get_parameter_source(name))
        }
        if passes_context:
            values["context"] = context
        verb(mission_of(set_by_user), **values)

    parameters = [*(_parameter(name, field) for name, field in fields.items()), *others.values()]
    parameters = sorted(map(_in_its_panel, parameters), key=_position_in_help)
    wrapped.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    wrapped.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return wrapped


def with_extra_options(*groups: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Replace a command's last parameter, `**values`, by the options of groups of entry points.

    Each object of a group has `options`: the annotated types of its options by the names of their parameters.  An
    option that the user has not set is None.
    """

    def decorate(verb: Callable[..., None]) -> Callable[..., None]:
        parameters = list(inspect.signature(verb, eval_str=True).parameters.values())[:-1]
        for extra in (extra for group in groups for extra in extensions(group).values()):
            for name, option in extra.options.items():
                keyword = inspect.Parameter.KEYWORD_ONLY
                parameters.append(inspect.Parameter(name, keyword, default=None, annotation=option))
        verb.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        verb.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        return verb

    return decorate


def is_users(source: Enum | None) -> bool:
    """Whether the value of a parameter, given by its source, is the user's, not the default."""
    return source is not None and source.name != "DEFAULT"


def mission_of(values: Mapping[str, Any]) -> MissionSpec:
    """Build the mission from option values by field name.

    Raises:
        BadInputError: A value is invalid; the message names option, value and allowed values.
    """
    for name in ("start", "goal"):
        point = values.get(name)
        if point is not None and not all(map(math.isfinite, point)):
            raise BadInputError(f"--{name}: {' '.join(map(str, point))}: allowed: three finite numbers (m)")
    try:
        return MissionSpec(**values)
    except ValidationError as error:
        first = error.errors()[0]
        name = str(first["loc"][0])
        value = first["input"]
        shown = repr(value) if isinstance(value, str) else str(value)
        reason = f"allowed: {_allowed(name)}"
        words = _words(MissionSpec.model_fields[name])
        if words:
            reason = not_known(value, words).removeprefix(f"{shown}: ")
        raise BadInputError(f"{option_name(name)}: {shown}: {reason}") from None


def listed(text: str) -> list[str]:
    """Parts of a comma-separated list."""
    return [part.strip() for part in text.split(",") if part.strip()]


def option_name(field: str) -> str:
    """Option name of a field, e.g. `--map-resolution` for `map_resolution`."""
    return "--" + field.replace("_", "-")


def _parameter(name: str, field: FieldInfo) -> inspect.Parameter:
    """The option of a field; words are checked by `mission_of`, whose message names those that are allowed."""
    kind: Any = str if _words(field) else field.annotation
    metavar = "X Y Z" if kind == Vector | None else None
    help_text, _, _ = str(field.description).partition(". ")  # the rest is for the reference
    completer = _COMPLETERS.get(name)
    if _words(field):
        completer = completion.of_words(_words(field))
    option = typer.Option(
        option_name(name), help=f"{help_text.rstrip('.')}.", metavar=metavar, autocompletion=completer
    )
    annotation = Annotated[kind, option]
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=field.default, annotation=annotation)


def _in_its_panel(parameter: inspect.Parameter) -> inspect.Parameter:
    """A parameter of a command, in the help panel of its name; others keep theirs."""
    panel = _PANEL_OF.get(parameter.name)
    if panel is None:
        if parameter.name not in MissionSpec.model_fields:
            return parameter
        panel = PIPELINE
    kind, option = get_args(parameter.annotation)
    option = copy(option)
    option.rich_help_panel = panel
    return parameter.replace(annotation=Annotated[kind, option])


def _position_in_help(parameter: inspect.Parameter) -> tuple[int, int]:
    """Positions of a parameter's panel, and in it; parameters without a panel are the first, those of extras last."""
    panel = -1
    for option in get_args(parameter.annotation)[1:]:
        if option.rich_help_panel in OF_OPTIONS:
            panel = OF_OPTIONS.index(option.rich_help_panel)
    names = list(_PANEL_OF)
    if parameter.name in names:
        return panel, names.index(parameter.name)
    return panel, len(names)


def _words(field: FieldInfo) -> tuple[str, ...]:
    """Allowed words of a `Literal` field, also of an optional one; empty for other types."""
    kinds = (field.annotation, *get_args(field.annotation))
    return next((get_args(kind) for kind in kinds if get_origin(kind) is Literal), ())


def _allowed(name: str) -> str:
    """Allowed values of a field, as text."""
    field = MissionSpec.model_fields[name]
    if name == "seed":
        return f"0 to {LARGEST_SEED}"
    words = _words(field)
    if words:
        return ", ".join(words)
    bounds = []
    for constraint in field.metadata:
        for side in ("ge", "le"):
            if hasattr(constraint, side):
                bounds.append(f"{float(str(getattr(constraint, side))):g}")
    return " to ".join(bounds) or str(field.description).partition(". ")[0]
