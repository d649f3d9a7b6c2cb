"""Write the reference page of the commands from the command line itself: help, arguments and options of each."""

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import typer

from mavfi.cli.commands import app
from mavfi.mission import MissionSpec
from tools.markers import GENERATED, banner

HEAD = """# Commands

Every command has `--help`, which prints the same. `--version` and `--allow-plugins` (run code and programs that files
name) stand before or after any command. In parentheses: the default.

"""
COMMON = """## Options of several commands

They are named only, where a command has them.

"""
_STYLE = re.compile(r"\[bold\](.*?)\[/bold\]", re.DOTALL)


def page() -> str:
    """All commands, in the order of `mavfi --help`; what several of them have in common stands first."""
    program = typer.main.get_command(app)
    common = _common(program)
    sections = [line for name, command in _members(program) for line in _section(f"mavfi {name}", command, common)]
    head = banner("make docs") + HEAD + COMMON + "\n".join([*common.values(), "", ""])
    return head + "\n".join(sections).rstrip() + "\n"


def _common(program: Any) -> dict[str, str]:  # noqa: ANN401
    """Parameters that two commands or more have with the same meaning, by label; those of missions are left out."""
    counter = Counter(
        _line(parameter)
        for command in _all_commands(program)
        for parameter in _parameters(command)
        if not _is_mission_key(parameter)
    )
    common: dict[str, str] = {}
    for line, count in counter.most_common():
        if count > 1:
            common.setdefault(_label_of(line), line)
    return dict(sorted(common.items()))


def _all_commands(group: Any) -> Iterator[Any]:  # noqa: ANN401
    for _, command in _members(group):
        yield command
        yield from _all_commands(command)


def _parameters(command: Any) -> list[Any]:  # noqa: ANN401
    return [parameter for parameter in command.params if not parameter.hidden]


def _is_mission_key(parameter: Any) -> bool:  # noqa: ANN401
    """Whether an option is a key of missions, which have a page of their own."""
    field = MissionSpec.model_fields.get(parameter.name)
    return field is not None and (parameter.help or "").split("[dim]")[0].strip().rstrip(".") in (
        field.description or ""
    )


def _members(group: Any) -> Iterator[tuple[str, Any]]:  # noqa: ANN401 (Typer's own types are private)
    """Commands of a group that are shown, by name; none = it is a command itself."""
    for name, command in getattr(group, "commands", {}).items():
        if not command.hidden:
            yield name, command


def _section(name: str, command: Any, common: Mapping[str, str]) -> Iterator[str]:  # noqa: ANN401
    """Heading, help and parameters of a command, then its own commands."""
    yield f"{'#' * (1 + name.count(' '))} `{name}`"
    yield ""
    yield text_of(command.help or "")
    yield ""
    lines = []
    shared = []
    of_missions = []
    for parameter in _parameters(command):
        line = _line(parameter)
        label = _label_of(line)
        if _is_mission_key(parameter):
            of_missions.append(label)
        elif common.get(label) == line:
            shared.append(label)
        else:
            lines.append(line)
    if shared:
        lines.append(f"- also {', '.join(shared)}")
    if of_missions:
        lines.append(f"- [keys of the mission](mission-keys.md): {', '.join(of_missions)}")
    if lines:
        yield from (*lines, "")
    for member, inner in _members(command):
        yield from _section(f"{name} {member}", inner, common)


def text_of(help_text: str) -> str:
    """A help text in Markdown: its examples are code, its brackets are no links."""
    plain = help_text.replace("\\[", "[")
    coded = _STYLE.sub(lambda match: f"`{' '.join(match[1].split())}`", plain)
    parts = coded.split("`")
    parts[::2] = [part.replace("[", "\\[") for part in parts[::2]]  # every second one is code
    return "`".join(parts)


def _line(parameter: Any) -> str:  # noqa: ANN401
    """One item of a list of parameters."""
    if parameter.param_type_name == "argument":
        label = f"`{parameter.name.upper()}`"
    else:
        label = " / ".join(f"`{option}`" for option in (*parameter.opts, *parameter.secondary_opts))
    default = ""
    if parameter.required:
        default = " (required)"
    elif parameter.default is not False and parameter.default not in (None, "", (), []):
        default = f" (`{parameter.default}`)"
    help_text, *_ = (parameter.help or "").split("[dim]")  # the default stands in parentheses
    meaning = " ".join(text_of(help_text).split())
    return f"- {label}{default}: {meaning}"


def _label_of(line: str) -> str:
    """The names of a parameter in its item."""
    return line.removeprefix("- ").partition(": ")[0].partition(" (")[0]


def pages() -> dict[Path, str]:
    """Content of the page, by path."""
    return {GENERATED / "commands.md": page()}
