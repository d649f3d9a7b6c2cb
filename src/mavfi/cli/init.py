"""`mavfi init`: a commented start that works, to be changed: a campaign, a detector, a planner, a ROS 2 node."""

from pathlib import Path
from typing import Annotated

import typer

from mavfi.cli import completion
from mavfi.cli.console import check_name, console
from mavfi.errors import BadInputError, write_text
from mavfi.files import exists, make_folder
from mavfi.plugins import extensions

HELP_PANEL = "Tools"
DATA = Path(__file__).parents[1] / "data"
SCHEMAS = DATA / "schemas"
"""Folder of the JSON schemas of campaigns and studies."""
GROUP = "mavfi.templates"
"""Group of entry points: the folder of a template, by its name.

A folder has the files of the template, and `NEXT`, which is printed: commands to go on with, one a line.  In both,
`SCHEMAS` stands for the folder of the schemas.
"""
_NEXT = "NEXT"


def templates() -> dict[str, Path]:
    """The folders of all templates, by name."""
    folders = {folder.name: folder for folder in sorted((DATA / "templates").iterdir())}
    return folders | extensions(GROUP)


def init(
    template: Annotated[
        str,
        typer.Argument(
            metavar="TEMPLATE",
            help="campaign, detector, planner, or node (of ROS 2).",
            autocompletion=completion.of_words(("campaign", "detector", "planner", "node")),
        ),
    ],
    directory: Annotated[Path, typer.Argument(metavar="[DIR]", help="Folder; made if absent.")] = Path(),
) -> None:
    """Write working, commented files to begin with.

    No file is overwritten. It prints the next commands.

    Example: [bold]mavfi init detector my_study[/bold]
    """
    folders = templates()
    check_name("template", template, folders)
    texts = {
        path.name: path.read_text(encoding="utf-8") for path in sorted(folders[template].iterdir()) if path.is_file()
    }
    next_steps = texts.pop(_NEXT)
    for name in texts:
        if exists(directory / name):
            raise BadInputError(f"{directory / name}: exists; allowed: a folder without it, mavfi init {template} DIR")
    make_folder(directory)
    for name, text in texts.items():
        write_text(directory / name, text.replace("SCHEMAS", str(SCHEMAS)))
    out = console()
    out.print(f"wrote {', '.join(map(str, texts))} in {directory.absolute()}", markup=False, soft_wrap=True)
    if directory != Path():
        out.print(f"  cd {directory}", markup=False, soft_wrap=True)
    for line in next_steps.splitlines():
        out.print(f"  {line}", markup=False, soft_wrap=True)
