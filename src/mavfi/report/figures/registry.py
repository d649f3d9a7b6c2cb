"""`Drawing`: runs of a campaign -> figure.  Every figure is a drawing."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from mavfi.analysis.runs import Runs
from mavfi.dropped import dropped_name
from mavfi.errors import BadInputError
from mavfi.plugins import Catalogue
from mavfi.report import style


@dataclass(frozen=True, slots=True)
class Drawing:
    """Definition of a figure for reports."""

    name: str  # key in studies, and name of its file
    draw: Callable[[Runs], Figure | None]  # returns None if not applicable to these runs
    caption: str | Callable[[Runs], str]
    general: bool = False  # included in the report of every campaign; others only if a study lists them
    cases: Callable[[Runs], Sequence[str]] = lambda _: ()
    """Ids of runs that `draw` needs as whole flights; the caller replays them, see `Runs.flights`."""

    def caption_of(self, runs: Runs) -> str:
        """The caption for these runs."""
        return self.caption if isinstance(self.caption, str) else self.caption(runs)


FIGURES: Mapping[str, Drawing] = Catalogue("mavfi.figures")
"""By name, in the order of reports."""


def drawing(name: str) -> Drawing:
    """Find a figure by name.

    Raises:
        BadInputError: The figure does not exist.
    """
    if name not in FIGURES:
        allowed = f"figure {name!r}: not known; allowed: {', '.join(FIGURES)}"
        raise BadInputError(dropped_name("figures", name) or allowed)
    return FIGURES[name]


def figure(runs: Runs, name: str) -> Figure:
    """Draw one figure of a report.

    Args:
        runs: Runs of a campaign, with flights if the figure needs them.
        name: A key of `FIGURES`.

    Raises:
        BadInputError: The figure does not exist, or is not applicable to these runs.
    """
    with style.house_style():
        made = drawing(name).draw(runs)
    if made is None:
        raise BadInputError(f"figure {name!r}: these runs have nothing to show in it; needed: runs with a fault")
    return made


def draw(
    runs: Runs, directory: Path, names: Sequence[str] | None = None, start: str = ""
) -> Mapping[str, str]:  # fmt: skip
    """Draw all applicable figures as PNG files.

    Args:
        runs: Runs of a campaign, with flights if a figure needs them.
        directory: Folder for the files.
        names: Keys of `FIGURES`; None = the general ones.
        start: Prefix of the file names.

    Returns:
        Captions by file name.

    Raises:
        BadInputError: A figure does not exist, or the directory cannot be written.
    """
    if names is None:
        names = [name for name, found in FIGURES.items() if found.general]
    captions = {}
    with style.house_style():
        for name in names:
            made = drawing(name).draw(runs)
            if made is not None:
                file = f"{start}{name}.png"
                style.write(made, directory / file)
                captions[file] = drawing(name).caption_of(runs)
    return captions
