"""The page of a flight: an interactive 3-D scene, time lines around the fault, the explanation, and commands."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from mavfi.errors import write_text
from mavfi.report.explain import Lines
from mavfi.report.html import page
from mavfi.report.html.flight_data import Course, flight_data
from mavfi.sim.environments import World


@dataclass(frozen=True, slots=True)
class FlightPage:
    """Text and plain data of one page.

    Attributes:
        title: Site of the fault.
        context: Environment, seed and configuration of the flight.
        verdict: Effect of the fault and result of the mission, in a sentence.
        story: Explanation as headings and sentences.
        commands: Descriptions and commands.
        data: Result of `flight_data`.
    """

    title: str
    context: str
    verdict: str
    story: Lines
    commands: Sequence[tuple[str, str]]
    data: dict[str, Any]

    @staticmethod
    def of(
        context: str, story: Lines, commands: Sequence[tuple[str, str]], courses: Sequence[Course], world: World,
        site: str = "",
    ) -> "FlightPage":  # fmt: skip
        """Create the page of flights of one mission; the first sentence of the story is the verdict."""
        (_, verdict), *rest = story
        title = f"Fault in {site}" if site else "A flight without a fault"
        return FlightPage(title, context, verdict, rest, commands, flight_data(courses, world, site))

    def to_json(self) -> dict[str, Any]:
        """Plain data for the template and scripts."""
        return asdict(self)


def write_flight_page(path: Path, flight: FlightPage) -> Path:
    """Write the page of one flight; `BadInputError` if the file cannot be written."""
    write_text(path, page.render("flight.html.j2", flight=flight.to_json()))
    return path
