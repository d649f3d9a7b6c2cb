"""`Drawing`: rows of a campaign -> a figure.  A new figure is a drawing; all are found by name in `FIGURES`."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from mavfi.campaign.analysis.runs import Runs
from mavfi.errors import BadInputError
from mavfi.reports import style


@dataclass(frozen=True, slots=True)
class Drawing:
    """A figure that reports can show."""

    name: str  # by which users ask for it, and of its file
    draw: Callable[[Runs], Figure | None]  # None = these runs have nothing to show in it
    caption: str | Callable[[Runs], str]
    general: bool = False  # in the report of every campaign; others where a study names them
    cases: Callable[[Runs], Sequence[str]] = lambda _: ()
    """Ids of runs that `draw` needs as whole flights: the caller flies them again, see `Runs.flights`."""

    def caption_of(self, runs: Runs) -> str:
        """Its caption for these runs."""
        return self.caption if isinstance(self.caption, str) else self.caption(runs)


FIGURES: dict[str, Drawing] = {}  # all figures by name, in the order in which reports show them


def register(*drawings: Drawing) -> None:
    """Add figures; a later one of the same name replaces the earlier one."""
    FIGURES.update({drawing.name: drawing for drawing in drawings})


def drawing(name: str) -> Drawing:
    """A figure by its name.

    Raises:
        BadInputError: There is no such figure.
    """
    if name not in FIGURES:
        raise BadInputError(f"figure {name!r}: not known; allowed: {', '.join(FIGURES)}")
    return FIGURES[name]


def figure(runs: Runs, name: str) -> Figure:
    """One figure of a report.

    Args:
        runs: Of a campaign; with flights, where the figure needs some.
        name: A key of `FIGURES`.

    Raises:
        BadInputError: There is no such figure, or these runs have nothing to show in it.
    """
    with style.house_style():
        made = drawing(name).draw(runs)
    if made is None:
        raise BadInputError(f"figure {name!r}: these runs have nothing to show in it; needed: runs with a fault")
    return made


def draw(
    runs: Runs, directory: Path, names: Sequence[str] | None = None, start: str = ""
) -> Mapping[str, str]:  # fmt: skip
    """Draw figures for which there is something to show, as PNG files.

    Args:
        runs: Of a campaign.
        directory: Where the files are written.
        names: Keys of `FIGURES`; None = the general ones.
        start: How the names of the files begin.

    Returns:
        Captions by the name of the file in the directory.

    Raises:
        BadInputError: There is no such figure, or the directory cannot be written.
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
