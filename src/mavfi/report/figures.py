"""`Drawing`: runs of a campaign -> figure.  Every figure is a drawing."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from mavfi.analysis.runs import Runs
from mavfi.dropped import dropped_name
from mavfi.errors import BadInputError, not_known
from mavfi.plugins import Catalogue
from mavfi.report import style
from mavfi.report.notebook import NotebookFigure


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
        if isinstance(self.caption, str):
            return self.caption
        return self.caption(runs)


FIGURES: Mapping[str, Drawing] = Catalogue("mavfi.figures")
"""By name, in the order of reports."""


def drawing(name: str) -> Drawing:
    """Find a figure by name.

    Raises:
        BadInputError: The figure does not exist.
    """
    if name not in FIGURES:
        refusal = f"figure {not_known(name, FIGURES)}"
        raise BadInputError(dropped_name("figures", name) or refusal)
    return FIGURES[name]


@dataclass(frozen=True, slots=True)
class Drawn:
    """A figure of some runs."""

    name: str
    figure: Figure
    caption: str


def drawn(runs: Runs, names: Sequence[str] | None = None) -> list[Drawn]:
    """Draw figures, without those that are not applicable.

    Args:
        runs: Runs of a campaign, with flights if a figure needs them.
        names: Keys of `FIGURES`; None = the general ones, if there are flights.

    Raises:
        BadInputError: A figure does not exist.
    """
    if names is None:
        names = [name for name, drawing in FIGURES.items() if drawing.general and runs.has_missions]
    figures = []
    with style.house_style():
        for definition in map(drawing, names):
            figure = definition.draw(runs)
            if figure is not None:
                figures.append(Drawn(definition.name, figure, definition.caption_of(runs)))
    return figures


def figure(runs: Runs, name: str) -> NotebookFigure:
    """Draw one figure of a report.

    Raises:
        BadInputError: The figure does not exist, or is not applicable to these runs.
    """
    figures = drawn(runs, [name])
    if not figures:
        raise BadInputError(f"figure {name!r}: these runs have nothing to show in it; needed: runs with a fault")
    return NotebookFigure.of(figures[0].figure)


def draw(runs: Runs, directory: Path, names: Sequence[str] | None = None, start: str = "") -> Mapping[str, str]:
    """Write figures (see `drawn`) as PNG files, whose names begin with `start`; returns captions by file name.

    Raises:
        BadInputError: A figure does not exist, or the directory cannot be written.
    """
    captions = {}
    for result in drawn(runs, names):
        file = f"{start}{result.name}.png"
        with style.house_style():
            style.write(result.figure, directory / file)
        captions[file] = result.caption
    return captions
