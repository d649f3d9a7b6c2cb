"""Write the reference pages of docs/generated from the data models behind YAML files and command line.

Each page has a list of keys per model: type, default and meaning, all taken from the model.
"""

import inspect
from collections.abc import Iterable
from dataclasses import MISSING, fields
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from mavfi import config
from mavfi.campaign import config as campaigns
from mavfi.detectors.registry import DetectorConfig
from mavfi.extras.paper.failure_rate import UpsetConfig
from mavfi.extras.paper.redundancy import DesignConfig
from mavfi.extras.paper.study import Study
from mavfi.faults.fault import find_level, level_names
from mavfi.flight.host import GROUP
from mavfi.mission import MissionSpec
from mavfi.plugins import extensions
from tools.markers import GENERATED, banner

COMMAND = "make docs"
NAMES = {"str": "text", "int": "integer", "float": "number", "bool": "true or false", "Any": "any value"}
SIGNS = {Ge: "≥", Gt: ">", Le: "≤", Lt: "<"}

MISSION = """# Keys of a mission

One model, `mavfi.MissionSpec`, is read by the command line (`--v-max 5`), by campaigns (`mission:` and `arms:`), by
`mavfi ros fly`, by training, and from Python. `stack` is accepted for `autopilot`.

"""
CAMPAIGN = """# Keys of a campaign and of a study

A campaign is a YAML file: `mavfi campaign run FILE`. An unknown key is an error that names file and key. Shipped ones
are in `configs/campaigns` and `configs/studies`; `mavfi init campaign` writes one to begin with, whose first line names
the JSON schema by which editors check and complete keys. Keys under `mission` and the overrides of an arm are the
[keys of a mission](mission-keys.md).

"""
FAULTS = """# Fault specifications

As text, for `--fault` of `mavfi fly` and `mavfi ros fly`; whatever is left out is drawn from `--fault-seed`:

| text | meaning |
|---|---|
| `null` | null fault: the whole way through the injector, with an empty mask |
| `state:planning.waypoint` | one bit of one field of one publication |
| `state:planning.waypoint.x` | of this field |
| `state:planning.trajectory.x[3]` | of this element; of a shorter list, of its last |
| `state:planning.waypoint.x:bit=62@20.0` | bit 62 of the first publication at or after 20 s |
| `state:planning.waypoint.x:bit=60:lasts=1@5` | stuck at its flipped value for 1 s; `inf` = for ever |
| `state:planning.waypoint.x:lasts=10:share=0.2` | for 10 s, in 20 % of the publications |
| `state:planning.waypoint.x:bit=62:also=y.60+z.3@5` | in the same publication bit 60 of y and bit 3 of z as well |
| `state:planning.waypoint.x:width=4:times=2` | 4 adjacent bits, in two publications, recomputed ones included |
| `state:control.command.vx:set=nan@10..12` | not a number in every publication from 10 to 12 s; \
[all operations](../reference/faults.md#operations) |
| `state:planning.trajectory.y[3]:bias=2@trajectory_seq>1` | 2 m added, at the first replan |
| `message:planning.trajectory:drop@10..12` | whole publications are lost |
| `message:control.command:delay=0.2:times=20` | 20 of them are late, from a drawn one on |
| `memory:planner` | one bit of what the kernel remembers, at an instant of the golden flight |
| `memory:planner.acted_seq` | of the words with this name, or the end or a part of it |
| `memory:waypoint.points[33]:bit=62@20.0` | bit 62 of word 33 of an array, before the steps at 20 s |
| `sensor:gyro:drift@10` | the gyro's error grows from 10 s ([types](../reference/faults.md#sensors-and-motors)) |
| `sensor:motor2:off:lasts=0.5` | motor 2 stands still for 0.5 s, from an instant of the golden flight on |
| `instruction:octomap` | one bit in the result of one instruction that the kernel executes |
| `instruction:pid:which=floating_point` | of this class ([instruction level](../reference/instruction-level.md)) |
| `instruction:pid:model=zero` | the value becomes zero; other models: `one_bit`, `bits`, `random`, \
`low_byte`, `high_bits` |
| `instruction:pid.track:call=7:index=42:bit=3:budget=N:ir=DIGEST` | one instruction of one call, as `mavfi shrink` \
prints it; `bit=3+7` flips two bits, `value=0x0` replaces the value |

As data, in ledgers, in `mavfi explain --json`, and in Python:

"""
CONFIGS = """# Keys of vehicles, platforms, autopilot profiles, planners, environments, detectors, redundancy, upsets

Files in `configs/`, and your own: every option that takes a name also takes the path of such a file.

"""
SECTIONS: dict[str, tuple[str, tuple[type[BaseModel], ...]]] = {
    "mission-keys.md": (MISSION, (MissionSpec,)),
    "campaign-keys.md": (
        CAMPAIGN,
        (
            campaigns.Campaign,
            *(find_level(name).sampling for name in level_names()),
            *(level.sampling for host in extensions(GROUP).values() for level in host.samplings.values()),
            *(host.config for host in extensions(GROUP).values() if host.config is not None),
            Study,
        ),
    ),
    "config-keys.md": (
        CONFIGS,
        (
            config.VehicleConfig,
            config.PlatformConfig,
            config.AutopilotConfig,
            config.PlannerConfig,
            config.EnvironmentConfig,
            config.CameraConfig,
            config.MapConfig,
            config.WindConfig,
            config.LocalizationConfig,
            DetectorConfig,
            DesignConfig,
            UpsetConfig,
        ),
    ),
}
"""Introduction and models of each page; nested models receive a section as well."""


def with_parts(model: type[BaseModel]) -> list[type[BaseModel]]:
    """A model and its nested models, without duplicates, in order."""
    models = [model]
    for field in model.model_fields.values():
        for nested in _models(field.annotation):
            models += with_parts(nested)
    return list(dict.fromkeys(models))


def _models(annotation: Any) -> Iterable[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel) and annotation.model_fields:
        yield annotation
    for inner in get_args(annotation):
        yield from _models(inner)


def kind(annotation: Any) -> str:
    """A type in words: "list of text", "number or integer", or a link to a model's section."""
    arguments = get_args(annotation)
    origin = get_origin(annotation)
    if isinstance(annotation, UnionType):
        origin = Union
    if origin is Literal:
        return ", ".join(f"`{value}`" for value in arguments)
    if origin is Union:
        return " or ".join(dict.fromkeys(kind(part) for part in arguments if part is not NoneType))
    if origin is Annotated:
        return kind(arguments[0])
    if origin is tuple:
        return _kind_of_tuple(arguments)
    if origin is dict:
        return _kind_of_dict(arguments)
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        if annotation.model_fields:
            return f"[{annotation.__name__}](#{annotation.__name__.lower()})"
        return "keys and values"
    name = getattr(annotation, "__name__", str(annotation))
    return NAMES.get(name, name)


def _kind_of_tuple(elements: tuple[Any, ...]) -> str:
    if Ellipsis in elements:
        return f"list of {kind(elements[0])}"
    kinds = [kind(element) for element in elements]
    if len(set(kinds)) > 1:
        return f"({', '.join(kinds)})"
    return f"{len(elements)} × {kind(elements[0])}"


def _kind_of_dict(key_and_value: tuple[Any, ...]) -> str:
    value = key_and_value[1]
    if value is Any:
        return "keys and values"
    return f"{kind(value)} by name"


def limits(field: FieldInfo) -> str:
    """Range of a number as text, e.g. "≥ 1, ≤ 100"; "" if unbounded."""
    bounds = []
    for rule in field.metadata:
        sign = SIGNS.get(type(rule))
        if sign is not None:
            bound = getattr(rule, type(rule).__name__.lower())  # `Ge` has the attribute `ge`
            bounds.append(f"{sign} {bound:g}")
    return ", ".join(bounds)


def shown(value: Any) -> str:
    """A default in YAML notation."""
    if value is None or value in ("", (), {}):
        return ""
    if isinstance(value, BaseModel):
        return "its defaults"
    if isinstance(value, dict):
        return ", ".join(f"`{name}: {_item(item)}`" for name, item in value.items())
    if isinstance(value, tuple):
        return f"`[{', '.join(map(str, value))}]`"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    return f"`{value}`"


def _item(value: Any) -> str:
    """A value of a default that is a mapping."""
    if isinstance(value, (int, float)):
        return f"{value:g}"
    return str(value)


def model_section(model: type[BaseModel]) -> list[str]:
    """Heading, docstring and keys of one model."""
    lines = [f"## {model.__name__}", "", *inspect.cleandoc(model.__doc__ or "").splitlines(), ""]
    for name, field in model.model_fields.items():
        default = "required"
        if not field.is_required():
            default = shown(field.get_default(call_default_factory=True))
        words = "; ".join(filter(None, ((field.description or "").rstrip("."), limits(field))))
        lines.append(item(name, kind(field.annotation), default, words))
    return [*lines, ""]


def attributes(docstring: str) -> dict[str, str]:
    """Entries of a docstring's section `Attributes:`, by name."""
    meanings: dict[str, str] = {}
    name = ""
    _, _, section = inspect.cleandoc(docstring).partition("Attributes:\n")
    for line in section.partition("\n\n")[0].splitlines():
        head, colon, rest = line.strip().partition(": ")
        begins_entry = line.startswith("    ") and not line.startswith("     ")  # further lines are indented more
        if begins_entry and colon:
            name = head
            meanings[name] = rest
        else:
            meanings[name] += " " + line.strip()
    return meanings


def fault_section(level: str, fault: Any) -> list[str]:
    """Heading, first sentence and attributes of one fault type."""
    hints = get_type_hints(fault)
    meanings = attributes(fault.__doc__)
    lines = [f"## Level `{level}`: {fault.__name__}", "", inspect.cleandoc(fault.__doc__).splitlines()[0], ""]
    for field in fields(fault):
        default = "required"
        if field.default is not MISSING:
            default = shown(field.default)
        lines.append(item(field.name, _kind_of_attribute(hints[field.name]), default, meanings[field.name]))
    return [*lines, ""]


def _kind_of_attribute(annotation: Any) -> str:
    """A type in words; a site is that of a state."""
    if isinstance(annotation, type) and annotation.__name__ in NAMES:
        return NAMES[annotation.__name__]
    if getattr(annotation, "__name__", "") == "FaultSite":
        return "state, field, element"
    return kind(annotation)


def item(name: str, type_name: str, default: str, meaning: str) -> str:
    """One item of a list of keys: name, type and default in parentheses, meaning."""
    in_parentheses = ", ".join(filter(None, (type_name, default)))
    text = f"- `{name}` ({in_parentheses})"
    if meaning:
        text += f": {meaning}"
    return " ".join(text.split())


def pages() -> dict[Path, str]:
    """Content of every reference page, by path."""
    contents = {}
    for name, (head, models) in SECTIONS.items():
        all_models = dict.fromkeys(part for model in models for part in with_parts(model))
        contents[GENERATED / name] = _page(head, map(model_section, all_models))
    sections = (fault_section(level, find_level(level).fault) for level in level_names())
    contents[GENERATED / "fault-specs.md"] = _page(FAULTS, sections)
    return contents


def _page(head: str, sections: Iterable[list[str]]) -> str:
    return banner(COMMAND) + head + "\n".join(line for section in sections for line in section).rstrip() + "\n"
