"""`mavfi reproduce`: train detectors, fly the campaigns of a study, write its reports, print its headline."""

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from mavfi.cli import completion, options
from mavfi.cli.console import PICTURES, check_file, console, say_written, write_json
from mavfi.cli.stopping import stoppable
from mavfi.errors import BadInputError
from mavfi.files import check_folder, is_file

if TYPE_CHECKING:
    from mavfi.analysis.runs import Runs
    from mavfi.campaign.config import Campaign
    from mavfi.campaign.executors.local import LocalExecutor
    from mavfi.campaign.training import RecordedFlights
    from mavfi.extras.paper.cli_report import StudyBar
    from mavfi.extras.paper.study import Study
    from mavfi.mission import MissionSpec

HELP_PANEL = "Campaigns"
MODELS = "models"
"""Subfolder of the study for the trained models."""
PAGE = "report.html"
"""Name of the study's page."""
FLIGHTS_EACH = 5
"""Flights of each campaign in the page: 1.5 MB and less than a minute of two processors for the paper's study;
`mavfi report DIR --html FILE --flights N` writes it with more."""
TIMED_VIEW = "overheads_as_in_the_paper"
"""View whose overheads are measured."""
TIMED_FLIGHTS = 3
"""Golden flights per environment and detector from which they are measured."""


def reproduce(  # noqa: PLR0913 - one parameter per option
    study: Annotated[
        str,
        typer.Argument(
            metavar="[STUDY.yaml]",
            help="A YAML file, or a shipped study.",
            autocompletion=completion.of_configs("studies"),
        ),
    ] = "paper",
    scale: Annotated[
        str, typer.Option(help="quick: minutes on two cores; paper: as many missions as the paper, about 21,500.")
    ] = "quick",
    out: Annotated[Path, typer.Option(help="Folder of everything that is written.")] = Path("out/reproduce"),
    workers: options.Workers = 2,
    show_all: options.AllTables = False,
    as_json: options.AsJson = False,
) -> None:
    """Fly a study, and compare its results with the paper's.

    Trains detectors, flies the campaigns, and compares tables and findings. Each campaign has a separate folder; those
    that fly the same missions share their golden flights. Writes report.html, study.md, study.json, figures and tables
    (CSV).

    Ctrl-C stops (exit code 130); the same command resumes.

    Example: [bold]mavfi reproduce --scale quick --out out/reproduce[/bold]
    """
    from mavfi.campaign.begin import begin
    from mavfi.campaign.executors.local import LocalExecutor
    from mavfi.campaign.run import run_campaigns
    from mavfi.campaign.training import record
    from mavfi.campaign.warm_up import compile_ahead
    from mavfi.extras.paper.cli_report import StudyBar, show_study_report, write_study_report
    from mavfi.extras.paper.overheads import measure, save
    from mavfi.extras.paper.provenance import note_run
    from mavfi.extras.paper.report import check_names
    from mavfi.extras.paper.study import load_study

    # everything that can be refused is refused before anything is flown
    full_study = load_study(study)
    check_names(full_study, study)
    scaled = full_study.at_scale(scale)
    campaigns = scaled.campaigns_at(scale)
    executor = LocalExecutor(workers)
    for folder, campaign in campaigns.items():
        _check_campaign(campaign, scaled.campaigns[folder], out / folder)
    check_folder(out)
    untrained_missions = _missions_to_train(campaigns.values(), out / MODELS, scaled.training_flights)
    detectors = {pair for campaign in campaigns.values() for pair in _detectors(campaign)}
    timed_folders = _folders_to_time(scaled, campaigns, out)

    # each step writes its results, so that the command can be stopped and resumed
    stop_message = f"Stopped. What is done is kept in {out}; the same command resumes."
    note_run(out, workers)
    with stoppable(stop_message), StudyBar(f"study {scaled.name}") as bar:
        bar.begin_step("compilation", "tasks")
        compile_ahead(campaigns.values(), executor, bar.show)
        fly = partial(record, out / MODELS, scaled.training_flights, workers=workers, progress=bar.show, only=detectors)
        _train(untrained_missions, fly, executor, bar)
        bar.begin_step("flights of all campaigns")
        started = {
            out / folder: begin(campaigns[folder], out / folder, models_dir=out / MODELS) for folder in campaigns
        }
        run_campaigns(started, executor=executor, progress=bar.show_campaigns)
        for folder in timed_folders:  # in one process, with no other work at the same time
            bar.begin_step("timed flights")
            save(measure(campaigns[folder], TIMED_FLIGHTS, out / MODELS, bar.show), out / folder)
        flights = FLIGHTS_EACH * len(campaigns)
        report, _ = write_study_report(scaled, scale, out, out / PAGE, flights, workers, bar=bar)

    # the headline, and where everything is
    if as_json:
        write_json(report.to_json())
        return
    show_study_report(report, show_all)
    _say_where(out, report.campaigns)


def _train(
    untrained_missions: Iterable["MissionSpec"],
    fly: Callable[..., "RecordedFlights"],
    executor: "LocalExecutor",
    bar: "StudyBar",
) -> None:
    """Fly training missions, and fit their models."""
    from mavfi.campaign.executors.executor import map_each
    from mavfi.campaign.training import RecordedFlights

    trainings = []
    for mission in untrained_missions:
        bar.begin_step("training flights")
        trainings.append(fly(mission))
    if trainings:
        bar.begin_step("fitting of detectors", "trainings")
        for done, _ in enumerate(map_each(executor, RecordedFlights.fit, trainings), 1):
            bar.show(done, len(trainings))


def _say_where(out: Path, campaigns: Mapping[str, "Runs"]) -> None:
    """Print where report, ledgers and models are, and the digests of the ledgers."""
    from mavfi.extras.paper.report import MARKDOWN
    from mavfi.report.text import short

    terminal = console()
    terminal.print(Text(f"The report: {out / PAGE} (tables, figures, runs, flights), {out / MARKDOWN} as text."))
    terminal.print("The ledgers, with their digests (mavfi campaign digest DIR prints one in full):")
    width = max((len(runs.campaign["name"]) for runs in campaigns.values()), default=0)
    for folder, runs in campaigns.items():
        name = runs.campaign["name"]
        digest = short(runs.campaign["digest"])
        terminal.print(Text(f"  {name:{width}}  {digest}  {out / folder}"), soft_wrap=True)
    terminal.print(f"The models are in {out / MODELS}.", soft_wrap=True)


def _missions_to_train(campaigns: Iterable["Campaign"], folder: Path, flights: int) -> list["MissionSpec"]:
    """Missions for which detectors are still to be trained, without duplicates."""
    untrained: dict[tuple[str, ...], MissionSpec] = {}
    for campaign in campaigns:
        if not _detectors(campaign):
            continue
        for mission in _missions(campaign):
            if not _is_trained(campaign, mission, folder, flights):
                untrained.setdefault(tuple(_trained_for(mission).values()), mission)
    return list(untrained.values())


def _folders_to_time(study: "Study", campaigns: Mapping[str, "Campaign"], out: Path) -> list[str]:
    """Folders of the campaigns whose overheads the study shows and nobody has measured yet."""
    from mavfi.extras.paper.overhead_views import load

    folders = dict.fromkeys(section.campaign for section in study.sections if TIMED_VIEW in section.views)
    return [folder for folder in folders if _detectors(campaigns[folder]) and not load(out / folder)]


def _check_campaign(campaign: "Campaign", source: str, ledger: Path) -> None:
    """Refuse a campaign of a file that names what does not exist, or whose ledger holds another one."""
    from mavfi.campaign.begin import check_names
    from mavfi.campaign.fingerprint import differences
    from mavfi.campaign.resolve import resolve
    from mavfi.campaign.run import identity_of
    from mavfi.campaign.store import FILE, Store

    check_names(campaign, source)
    if not is_file(ledger / FILE):
        return
    with Store.open(ledger) as store:
        stored = store.meta("identity")
    identity = identity_of(resolve(campaign).with_scenarios())
    # Without the models, which may still have to be trained.
    keys = ("campaign", "scenarios")
    differing = differences({key: stored.get(key) for key in keys}, {key: identity.get(key) for key in keys})
    if differing:
        raise BadInputError(f"{ledger}: holds another campaign (differs in: {differing}); choose another directory")


def _missions(campaign: "Campaign") -> list["MissionSpec"]:
    """Training missions of a campaign's detectors: one per platform, or that which `trained_for` names."""
    missions: dict[str, MissionSpec] = {}
    for environment in campaign.environments:
        mission = campaign.spec(environment, campaign.first_seed)
        if mission.trained_for:
            autopilot, platform = mission.trained_for.split("/")
            planner = type(mission).model_fields["planner"].default
            mission = mission.model_copy(update={"autopilot": autopilot, "platform": platform, "planner": planner})
        missions.setdefault(mission.platform, mission)
    return list(missions.values())


def _trained_for(mission: "MissionSpec") -> dict[str, str]:
    """Properties of a mission that determine the models of its detectors."""
    return {"stack": mission.autopilot, "platform": mission.platform, "planner": mission.planner}


def _is_trained(campaign: "Campaign", mission: "MissionSpec", folder: Path, flights: int) -> bool:
    """Whether the folder holds up-to-date models for a mission and all detectors of a campaign."""
    from mavfi.campaign.fingerprint import versions
    from mavfi.detectors.model import Model

    current_versions = versions()
    training = {**_trained_for(mission), "flights": flights}
    trained = set()
    for path in sorted(folder.glob("*.json")):
        try:
            model = Model.load(path)
        except BadInputError:
            return False
        origin = model.provenance
        fresh = all(current_versions.get(name) == version for name, version in origin.get("versions", {}).items())
        if fresh and all(origin.get(key) == value for key, value in training.items()):
            trained.add((model.kind, model.profile))
    return _detectors(campaign) <= trained


def _detectors(campaign: "Campaign") -> set[tuple[str, str]]:
    """Detectors of a campaign's arms, as (name, profile)."""
    return {(arm.detector, arm.profile) for arm in campaign.arms.values() if arm.detector}


# ---- `mavfi failures`: failures per flight hour of each setting of a campaign --------------------------------------


def failures(
    directory: options.Ledger,
    upsets: Annotated[
        str, typer.Option(metavar="NAME|FILE.yaml", help="Upset rates: shipped (configs/upsets), or your own.")
    ] = "low_altitude",
) -> None:
    """Compare settings by failures per flight hour.

    They are the product of upset rate, instructions (those of detectors and recovery included) and harm, the increase
    in mission failures per fault. Needs a campaign with instruction faults in which the golden runs of every arm are
    counted, e.g. failure_rate.

    Example: [bold]mavfi failures out/failure_rate --upsets my_upsets.yaml[/bold]
    """
    from rich.text import Text

    from mavfi.analysis.runs import Runs
    from mavfi.extras.paper.failure_rate import failure_table, find_upsets, summary
    from mavfi.report.text import show_table

    upset_rates = find_upsets(upsets)
    runs = Runs.read(directory)
    table = failure_table(runs, upset_rates)
    if not table.rows:
        raise BadInputError(f"{directory}: {_why_no_failures(runs)}; `mavfi campaign run failure_rate` flies such ones")
    out = console()
    for sentence in summary(runs, upset_rates):
        out.print(Text(sentence))
    out.print()
    show_table(table, out)


def _why_no_failures(runs: "Runs") -> str:
    """Why failures per flight hour cannot be computed from runs."""
    levels = runs.injected.values("level")
    if not levels:
        return "holds no faults; allowed: a campaign with faults in instructions"
    if "instruction" not in levels:
        return f"holds faults of level {', '.join(levels)}; allowed: a campaign with faults in instructions"
    return "holds no golden run whose instructions were counted; allowed: a campaign with such runs"


# ---- `mavfi redundancy`: flight time and energy of a UAV with redundant processors, compared with a detector -------


def redundancy(
    vehicle: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME|FILE.yaml",
            help="A shipped design (configs/redundancy), or a YAML file of your own; may be given several times. All "
            "shipped ones by default.",
        ),
    ] = None,
    picture: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Draw the comparison.")] = None,
    show_all: options.AllTables = False,
) -> None:
    """Compare redundant processors with detection, by a model.

    Flight time and energy with DMR, TMR and detection, by a performance model. Needs no flights. A vehicle file needs
    name, mass (kg) and max_thrust (N).

    Example: [bold]mavfi redundancy --vehicle my_drone.yaml --picture redundancy.png[/bold]
    """
    from rich.text import Text

    from mavfi.extras.paper.figures import redundancy as draw
    from mavfi.extras.paper.redundancy import (
        find_design,
        redundancy_headline,
        redundancy_tables,
        shipped_designs,
        summary,
    )
    from mavfi.report import style
    from mavfi.report.text import show_table

    check_file("--picture", picture, PICTURES)
    # The designs, their tables and their figure.
    if vehicle:
        designs = [find_design(name) for name in vehicle]
    else:
        designs = shipped_designs()
    tables = [redundancy_headline(designs)]
    if show_all:
        tables = redundancy_tables(designs)
    if picture is not None:
        with style.house_style():
            style.write(draw(designs), picture)

    # A sentence on each design, then the tables.
    out = console()
    for sentence in summary(designs):
        out.print(Text(sentence))
    out.print()
    for table in tables:
        show_table(table, out)
    if not show_all:
        out.print(Text("Energy, speed, mass, effect of each parameter, check of the model: --all.", style="dim"))
    say_written(picture)
