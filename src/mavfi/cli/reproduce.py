"""`mavfi reproduce`: train the detectors, fly the campaigns of a study, write its reports, end with the headline."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mavfi.cli import options
from mavfi.cli.console import check_folder, console, write_json
from mavfi.cli.stopping import stoppable
from mavfi.errors import BadInputError

if TYPE_CHECKING:
    from mavfi.campaign.config import Campaign, Study
    from mavfi.mission import MissionSpec

MODELS = "models"
"""Folder of the trained models, in the folder of the study."""


def reproduce(  # noqa: PLR0913 - one parameter per option
    study: Annotated[str, typer.Argument(metavar="[STUDY.yaml]", help="A YAML file, or a shipped study.")] = "paper",
    scale: Annotated[
        str, typer.Option(help="quick: 30 missions per environment (instruction level: 13); paper: 100.")
    ] = "quick",
    out: Annotated[Path, typer.Option(help="Folder of everything that is written.")] = Path("out/reproduce"),
    workers: options.Workers = 2,
    show_all: options.AllTables = False,
    as_json: options.AsJson = False,
) -> None:
    """Train the detectors, fly the paper's success table at both levels, write the reports.

    The campaigns of the study are flown one after the other, each into a folder of its own.

    Ctrl-C stops (exit code 130); the same command resumes.

    Example: [bold]mavfi reproduce --scale quick --out out/reproduce[/bold]
    """
    from mavfi.campaign.config import load_campaign, load_study
    from mavfi.campaign.executors.local import LocalExecutor
    from mavfi.campaign.run import run_campaign
    from mavfi.cli.progress import Bar, duration

    begun = time.perf_counter()
    chosen = load_study(study)
    campaigns = {out / folder: load_campaign(name).at_scale(scale) for folder, name in chosen.campaigns.items()}
    executor = LocalExecutor(workers)
    _check_views(study, chosen)
    for folder, campaign in campaigns.items():
        _check_ledger(campaign, folder)
    check_folder(out)
    watched = [campaign for campaign in campaigns.values() if any(arm.detector for arm in campaign.arms.values())]
    with stoppable(f"Stopped. What is done is kept in {out}; the same command resumes."):
        for campaign, mission in [(one, mission) for one in watched for mission in _missions(one)]:
            if not _trained(campaign, mission, out / MODELS, chosen.training_flights):
                from mavfi.campaign.training import train

                with Bar("training flights") as bar:
                    train(out / MODELS, chosen.training_flights, mission, workers=workers, progress=bar.show)
        for folder, campaign in campaigns.items():
            with Bar(f"{campaign.name}, {campaign.missions} missions per environment", "runs") as bar:
                show = bar.show_campaign
                run_campaign(campaign, folder, executor=executor, models_dir=out / MODELS, progress=show)
    _report(campaigns, {out / folder: names for folder, names in chosen.views.items()}, show_all, as_json)
    if not as_json:
        where = f"The models are in {out / MODELS}. It took {duration(time.perf_counter() - begun)}."
        console().print(where, soft_wrap=True)


def _check_views(where: str, study: "Study") -> None:
    from mavfi.campaign.analysis import VIEWS

    for folder, names in study.views.items():
        for name in names:
            if name not in VIEWS:
                raise BadInputError(f"{where}: views: {folder}: {name!r}: not known; allowed: {', '.join(VIEWS)}")


def _check_ledger(campaign: "Campaign", folder: Path) -> None:
    """Refuse a folder with another campaign before anything is trained or written there."""
    from mavfi.campaign.mission import scenarios_of
    from mavfi.campaign.plan import arms_of
    from mavfi.campaign.run import identity_of
    from mavfi.campaign.store import FILE, Store

    if not (folder / FILE).is_file():
        return
    with Store.open(folder) as store:
        held = store.meta("identity")
    wanted = identity_of(campaign, scenarios_of(campaign, arms_of(campaign)), {})
    differing = [key for key in ("campaign", "scenarios") if held.get(key) != wanted[key]]
    if differing:
        raise BadInputError(
            f"{folder}: holds another campaign (differs in: {', '.join(differing)}); choose another directory"
        )


def _missions(campaign: "Campaign") -> list["MissionSpec"]:
    """The missions that detectors are trained for: one for each platform."""
    found: dict[str, MissionSpec] = {}
    for environment in campaign.environments:
        mission = campaign.spec(environment, campaign.first_seed)
        found.setdefault(mission.platform, mission)
    return list(found.values())


def _trained(campaign: "Campaign", mission: "MissionSpec", folder: Path, flights: int) -> bool:
    """Whether the folder holds the models of a campaign's arms that training for a mission would give."""
    from mavfi.campaign.fingerprint import versions
    from mavfi.detectors.model import Model

    here = versions()
    wanted = {
        "stack": mission.autopilot, "platform": mission.platform, "planner": mission.planner, "flights": flights,
    }  # fmt: skip
    held = set()
    for path in sorted(folder.glob("*.json")):
        try:
            model = Model.load(path)
        except BadInputError:
            return False
        origin = model.provenance
        fresh = all(here.get(name) == version for name, version in origin.get("versions", {}).items())
        if fresh and all(origin.get(key) == value for key, value in wanted.items()):
            held.add((model.kind, model.profile))
    return all((arm.detector, arm.profile) in held for arm in campaign.arms.values() if arm.detector)


def _report(
    campaigns: dict[Path, "Campaign"], views: dict[Path, tuple[str, ...]], show_all: bool, as_json: bool
) -> None:
    """Write the report of each campaign, and print its headline, or its JSON by name of the campaign."""
    from mavfi.cli.report import show_report
    from mavfi.reports.campaign_report import write_report

    written = {folder: write_report(folder) for folder in campaigns}
    if as_json:
        write_json({campaigns[folder].name: report.to_json() for folder, report in written.items()})
        return
    for folder, report in written.items():
        show_report(report, show_all, views.get(folder, ()))
    for folder, report in written.items():
        names = ", ".join(path.name for path in report.files)
        console().print(f"[bold]{folder}[/bold] holds the ledger, and: {names}", soft_wrap=True)
