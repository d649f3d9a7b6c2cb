"""Completion in shells: `mavfi completion`, and the values of options and arguments.

A shell runs `mavfi` at each TAB.  So nothing here imports more than names need.
"""

import sqlite3
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer

from mavfi.cli.console import check_name
from mavfi.config import names
from mavfi.plugins import known

HELP_PANEL = "Tools"
SCRIPTS = Path(__file__).parents[1] / "data" / "completion"
"""Folder of the shells' scripts, `mavfi.SHELL`."""
_MOST_RUNS = 200
"""Run ids that are shown at a TAB."""

Completer = Callable[[str], list[str]]
"""Gives the words that a text may become; Typer leaves out those that do not begin with it."""


def completion(
    shell: Annotated[str, typer.Argument(metavar="bash|zsh|fish", help="The shell.")],
) -> None:
    """Print the script that completes commands in a shell.

    Commands, options, names, places of faults and run ids are then completed with TAB.

    Example: [bold]mavfi completion bash >> ~/.bashrc[/bold]
    """
    shells = sorted(path.suffix[1:] for path in SCRIPTS.iterdir())
    check_name("shell", shell, shells)
    typer.echo((SCRIPTS / f"mavfi.{shell}").read_text(encoding="utf-8"), nl=False)


def of_configs(*kinds: str) -> Completer:
    """Complete names of shipped configurations, e.g. of "campaigns"."""

    def complete(incomplete: str) -> list[str]:
        return [name for kind in kinds for name in names(kind)]

    return complete


def of_entry_points(group: str, *others: str) -> Completer:
    """Complete names of a group of entry points, and other ones."""

    def complete(incomplete: str) -> list[str]:
        return [*others, *sorted(known(group, {}))]

    return complete


def of_words(words: Iterable[str]) -> Completer:
    """Complete words of a list."""
    listed = list(words)

    def complete(incomplete: str) -> list[str]:
        return listed

    return complete


def trained_for(incomplete: str) -> list[str]:
    """Complete AUTOPILOT/PLATFORM."""
    return [f"{autopilot}/{platform}" for autopilot in names("autopilots") for platform in names("platforms")]


def fault(incomplete: str) -> list[str]:
    """Complete the level of a fault, then step by step where it is and what happens."""
    level, colon, target = incomplete.partition(":")
    if not colon:
        return ["null", *(f"{name}:" for name in _places())]
    places = _places().get(level, {})
    for name, further in places.items():
        # A place that is complete is followed by what it consists of, or by what happens to it.
        if further and target.startswith(name):
            return [f"{level}:{name}{part}" for part in further]
    return [f"{level}:{name}" for name in places]


def _places() -> dict[str, Mapping[str, Iterable[str]]]:
    """The places of faults by level, each with what may follow it."""
    from mavfi.faults.operations import MESSAGE_OPERATIONS
    from mavfi.levels.sensor.fault import FAILING, UNITS
    from mavfi.states import DETECTORS, INJECTABLE, KERNELS, STATES

    fields = {name: [field.name for field in (*spec.header, *spec.elements)] for name, spec in STATES.items()}
    return {
        "state": {f"{name}.": of_state for name, of_state in fields.items()},
        "memory": dict.fromkeys(KERNELS, ()),
        "instruction": dict.fromkeys([*INJECTABLE, *DETECTORS], ()),
        "sensor": {f"{unit}:": FAILING for unit in UNITS},
        "message": {f"{state}:": MESSAGE_OPERATIONS for state in STATES},
    }


def run_id(context: typer.Context, incomplete: str) -> list[str]:
    """Complete the id of a run in the ledger that was named before."""
    run_ids: list[str] = []
    directory = context.params.get("directory") or context.params.get("flight") or "."
    for path in Path(directory).glob("*.sqlite"):
        query = "SELECT run_id FROM runs WHERE substr(run_id, 1, ?) = ? ORDER BY position LIMIT ?"
        try:
            with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as connection:
                rows = connection.execute(query, (len(incomplete), incomplete, _MOST_RUNS)).fetchall()
        except sqlite3.Error:  # no ledger, or one that is being written: nothing is completed
            continue
        run_ids += [row[0] for row in rows]
    return run_ids
