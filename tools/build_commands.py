"""Write the reference page of the commands from the command line itself: help, arguments and options of each."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

from mavfi.cli.commands import app
from tools.markers import GENERATED, banner

HEAD = """# Commands

Every command has `--help`, which prints the same. `--version` and `--allow-plugins` (run code and programs that files
name) stand before or after any command.

"""
_STYLE = re.compile(r"\[bold\](.*?)\[/bold\]", re.DOTALL)


def page() -> str:
    """All commands, in the order of `mavfi --help`."""
    program = typer.main.get_command(app)
    sections = [line for name, command in _members(program) for line in _section(f"mavfi {name}", command)]
    return banner("make docs") + HEAD + "\n".join(sections).rstrip() + "\n"


def _members(group: Any) -> Iterator[tuple[str, Any]]:  # noqa: ANN401 (Typer's own types are private)
    """Commands of a group that are shown, by name; none = it is a command itself."""
    for name, command in getattr(group, "commands", {}).items():
        if not command.hidden:
            yield name, command


def _section(name: str, command: Any) -> Iterator[str]:  # noqa: ANN401
    """Heading, help and parameters of a command, then its own commands."""
    yield f"{'#' * (1 + name.count(' '))} `{name}`"
    yield ""
    yield text_of(command.help or "")
    yield ""
    rows = [_row(parameter) for parameter in command.params if not parameter.hidden]
    if rows:
        yield from ("| argument or option | default | meaning |", "|---|---|---|", *rows, "")
    for member, inner in _members(command):
        yield from _section(f"{name} {member}", inner)


def text_of(help_text: str) -> str:
    """A help text in Markdown: its examples are code."""
    return _STYLE.sub(lambda match: f"`{' '.join(match[1].split())}`", help_text).replace("\\[", "[")


def _row(parameter: Any) -> str:  # noqa: ANN401
    """One line of a table of parameters."""
    if parameter.param_type_name == "argument":
        label = f"`{parameter.name.upper()}`"
    else:
        label = ", ".join(f"`{option}`" for option in (*parameter.opts, *parameter.secondary_opts))
    default = ""
    if parameter.required:
        default = "required"
    elif parameter.default is not False and parameter.default not in (None, "", (), []):
        default = f"`{parameter.default}`"
    help_text, *_ = (parameter.help or "").split("[dim]")  # the default stands in its own column
    meaning = " ".join(text_of(help_text).split())
    return f"| {label} | {default} | {meaning} |"


def pages() -> dict[Path, str]:
    """Content of the page, by path."""
    return {GENERATED / "commands.md": page()}
