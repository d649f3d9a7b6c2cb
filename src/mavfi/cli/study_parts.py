"""Parts of a study for the progress bar of `mavfi reproduce`: their number of units, and the wall time of each."""

from collections.abc import Mapping
from pathlib import Path

from mavfi.campaign.config import Campaign
from mavfi.campaign.forecast import forecast
from mavfi.campaign.mission import plan_of
from mavfi.campaign.warm_up import tasks_ahead
from mavfi.cli.progress import Part
from mavfi.cli.study_report import PAGE, TABLES

COMPILATION, FITTING = "compilation", "fitting"
COMPILED_S, TRAINING_S, FITTED_S, TIMED_S = 9.6, 1.2, 19.0, 0.4
"""CPU time of a compilation task, a training flight, the fits of a training, and a timed flight (s).

These and the next ones were measured on one machine; they are weights of the progress bar and appear in no result."""
FIXED_S, TABULATED_S, SHOWN_S = 20.0, 0.013, 8.7
"""CPU time of tables and figures without runs (estimated), of each run in them, and of a flight of the page (s)."""
UNKNOWN_S = 1.0
"""Time of a run on a host for which nothing is assumed (s)."""


def training(place: int) -> str:
    """Name of the part of a training; the first is 1."""
    return f"training {place}"


def flying(folder: str) -> str:
    """Name of the part of a campaign."""
    return f"campaign {folder}"


def timing(folder: str) -> str:
    """Name of the part of the timed flights of a campaign."""
    return f"timing {folder}"


def study_parts(
    campaigns: Mapping[str, Campaign], out: Path, workers: int, *, trainings: int, training_flights: int,
    timed: Mapping[str, int], shown: int,
) -> dict[str, Part]:  # fmt: skip
    """What is to be done for a study, in this order.

    Args:
        campaigns: By folder of the ledger in `out`.
        out: Folder of the study.
        workers: Number of processes.
        trainings: Number of trainings that are lacking.
        training_flights: Number of flights of each.
        timed: Number of flights to be timed, by folder of the campaign; they fly in one process.
        shown: Number of flights of the page.

    Raises:
        BadInputError: A campaign cannot be flown, or its ledger is damaged.
    """
    flown = {flying(folder): _campaign(campaign, out / folder, workers) for folder, campaign in campaigns.items()}
    runs, reports = sum(part.total for part in flown.values()), 1 + len(campaigns)
    fitting = {FITTING: Part(0, trainings, FITTED_S / workers, flights=False)} if trainings else {}
    return {
        COMPILATION: Part(0, tasks_ahead(campaigns.values()), COMPILED_S / workers, flights=False),
        **{training(place): Part(0, training_flights, TRAINING_S / workers) for place in range(1, 1 + trainings)},
        **fitting,
        **flown,
        **{timing(folder): Part(0, flights, TIMED_S) for folder, flights in timed.items()},
        TABLES: Part(0, reports, (FIXED_S + TABULATED_S * runs) / workers / reports, flights=False),
        PAGE: Part(0, shown + 1, SHOWN_S / workers, flights=False),
    }


def _campaign(campaign: Campaign, folder: Path, workers: int) -> Part:
    """Flights of a campaign that are done and planned (at most), and the expected wall time of a remaining one."""
    found = forecast(plan_of(campaign, {}, {}), folder, workers)
    total = found.golden + found.injected
    left = max(1, total - found.done)
    return Part(found.done, total, UNKNOWN_S / workers if found.seconds is None else found.seconds / left)
