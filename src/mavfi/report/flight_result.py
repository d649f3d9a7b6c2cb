"""A requested flight with its golden run, and its results as plain data."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mavfi.errors import BadInputError, NotInstalledError, naming_extra, write_text
from mavfi.outcomes import QoF, quality_of
from mavfi.record import COLUMNS, FlightRecord, record_of
from mavfi.report.compared_flights import ComparedFlights

if TYPE_CHECKING:
    import polars

    from mavfi.flight.host import ArmSetup
    from mavfi.mission import MissionStatus, Scenario
    from mavfi.record import FlightLog
    from mavfi.report.notebook import NotebookFigure


@dataclass(frozen=True)
class FlownAs:
    """How a flight was flown, to fly it again with all publications, which its page shows.

    Attributes:
        setup: Mission, detector and recovery.
        without_detector: The mission without the detector and its mission keys.
        command: The command that repeats it; "" = none does.
    """

    setup: ArmSetup
    without_detector: Scenario
    command: str = ""


@dataclass(frozen=True, repr=False)
class FlightResult(ComparedFlights):
    """A flight, with those that it is compared with; a notebook shows its page.

    Attributes:
        flown_as: How it was flown; None = it cannot be flown again in this process.
    """

    flown_as: FlownAs | None = None

    def __repr__(self) -> str:
        mission = f"{self.scenario.environment.name}, seed {self.scenario.seed}"
        if self.detector:
            mission = f"{mission}, detector {self.detector}"
        fault = "golden"
        if self.fault and self.effect:
            fault = f"fault in {self.fault.site}: {self.effect.label}"
        return f"<FlightResult: {mission}, {fault}, {self.status.name} after {self.quality.flight_time_s:.2f} s>"

    @property
    def status(self) -> MissionStatus:
        """Final status of the mission."""
        return self.flight.log.status

    @property
    def quality(self) -> QoF:
        """Flight time, energy, distance."""
        return quality_of(self.record)

    @property
    def frame(self) -> polars.DataFrame:
        """The flight as a data frame: one row per control tick, columns as in `record.COLUMNS`."""
        import polars

        return polars.DataFrame(self.log.rows, schema=list(COLUMNS))

    def plot(self) -> NotebookFigure:
        """Draw the flight from above and from the side, with what it is compared with; a notebook shows the figure.

        Returns:
            A matplotlib figure, for `savefig` or further drawing.
        """
        with naming_extra("plot"):
            from mavfi.report.notebook import NotebookFigure
            from mavfi.report.picture import flight_figure

        if self.unwatched is None:
            figure = flight_figure(self.flight, self.golden, detector=self.detector)
        else:
            figure = flight_figure(self.unwatched, self.golden, self.flight, detector=self.detector)
        return NotebookFigure.of(figure)

    def html(self, path: Path | str | None = None) -> str | None:
        """The page of the flight, as `mavfi fly --html` writes it; the flights are repeated to record what it shows.

        Args:
            path: File to write; None = the page is returned instead.

        Raises:
            BadInputError: The file cannot be written, or the flight cannot be repeated in this process.
        """
        if path is None:
            return self._page
        write_text(Path(path), self._page)
        return None

    @cached_property
    def _page(self) -> str:
        with naming_extra("html"):
            from mavfi.report.html.flight_page import page_of_result, rendered_flight_page

        if self.flown_as is None:
            raise BadInputError("html: this flight cannot be repeated here; allowed: flights of the host 'local'")
        as_flown = self.flown_as
        page = page_of_result(self, as_flown.setup, as_flown.without_detector, as_flown.command)
        return rendered_flight_page(page)

    def _repr_html_(self) -> str | None:
        """The page in a notebook; None = the text of `repr`, since there is no page, or not without an extra."""
        if self.flown_as is None:
            return None
        try:
            page = self._page
        except NotInstalledError:
            return None
        from mavfi.report.notebook import framed

        return framed(page)

    def to_json(self) -> dict[str, Any]:
        """Plain data, the output of `mavfi fly --json`.

        Returns:
            status, status_text, flight_time_s, energy_j, distance_m, battery_used, digest, injections, alarms, replans,
            events (counts by kind), the mission (environment, seed, autopilot, platform, planner, map, vehicle, v_max,
            wind, localization, detector, start, goal, course_m, time_limit_s), fault, effect, kernel (effect of the
            injected call), golden (results of the golden run), and without_detector (results of the flight with the
            same fault, without the detector).  The last five are null for a golden flight, kernel also for faults of
            other levels, without_detector also without a detector.
        """
        log = self.flight.log
        scenario = self.scenario
        data: dict[str, Any] = {
            **_figures(log, self.record),
            "injections": [injection.to_json() for injection in log.injections],
            "alarms": [alarm.to_json() for alarm in log.alarms],
            "replans": self.record.replans,
            "events": dict(self.record.events),
            "environment": scenario.environment.name,
            "seed": scenario.seed,
            "autopilot": scenario.autopilot.name,
            "platform": scenario.platform.name,
            "planner": scenario.planner.name,
            "map": scenario.map.kind,
            "vehicle": scenario.vehicle.name,
            "v_max": scenario.v_max,
            "wind": scenario.wind.gust,
            "localization": scenario.localization.kind,
            "detector": self.detector,
            **{key: log.meta[key] for key in ("start", "goal", "course_m", "time_limit_s")},
            "fault": None,
            "effect": None,
            "kernel": None,
            "golden": None,
            "without_detector": None,
        }
        # what only a flight with a fault has
        if self.fault is not None:
            data["fault"] = self.fault.to_json()
        if self.effect is not None:
            data["effect"] = self.effect.label
        if log.kernel is not None:
            data["kernel"] = asdict(log.kernel)
        if self.golden is not None and self.golden_record is not None:
            data["golden"] = _figures(self.golden.log, self.golden_record)
        if self.unwatched is not None:
            data["without_detector"] = _figures(self.unwatched.log, record_of(self.unwatched.log))
        return data


def _figures(log: FlightLog, record: FlightRecord) -> dict[str, Any]:
    """Results that each of the compared flights has."""
    return {
        "status": log.status.label,
        "status_text": log.status.value,
        **asdict(quality_of(record)),
        "digest": record.digest,
    }
