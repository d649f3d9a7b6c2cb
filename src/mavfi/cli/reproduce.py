"""`mavfi reproduce`: train the detectors, fly the paper's table at both levels, print and write the reports."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mavfi.cli.console import JSON_HELP, check_folder, console, write_json
from mavfi.cli.stopping import stoppable
from mavfi.errors import BadInputError

if TYPE_CHECKING:
    from mavfi.campaign.config import Campaign

TRAINING_FLIGHTS = 100
_STATES, _INSTRUCTIONS = "table1", "table1_instructions"
INSTRUCTIONS_FOLDER = "instructions"
"""Where in the folder the instruction level is; the state level is in the folder itself."""


def reproduce(
    scale: Annotated[
        str, typer.Option(help="quick: 30 missions per environment (instruction level: 13); paper: 100.")
    ] = "quick",
    out: Annotated[Path, typer.Option(help="Folder of everything that is written.")] = Path("out/reproduce"),
    workers: Annotated[int, typer.Option(help="Processes; the result does not depend on them.")] = 2,
    as_json: Annotated[bool, typer.Option("--json", help=JSON_HELP)] = False,
) -> None:
    """Train the detectors, fly the paper's success table, print it, write the reports.

    It is flown twice: with faults in the values between kernels (state level), and with faults in executed
    instructions (instruction level, as the paper did).

    Ctrl-C stops (exit code 130); the same command goes on where it stopped.

    Example: [bold]mavfi reproduce --scale quick --out out/reproduce[/bold]
    """
    from mavfi.campaign.config import load_campaign
    from mavfi.campaign.executors.local import LocalPool
    from mavfi.cli.progress import import_host

    begun = time.perf_counter()
    campaigns = {
        out: load_campaign(_STATES).at_scale(scale),
        out / INSTRUCTIONS_FOLDER: load_campaign(_INSTRUCTIONS).at_scale(scale),
    }
    LocalPool(workers)  # refuses a number that is none
    for folder, campaign in campaigns.items():
        _check_ledger(campaign, folder)
    check_folder(out)
    trained = all(_trained(campaign, out / "models") for campaign in campaigns.values())
    import_host(training=not trained)
    with stoppable(f"Stopped. What is done is kept in {out}; the same command goes on."):
        if not trained:
            _train(campaigns[out], out / "models", workers)
        for folder, campaign in campaigns.items():
            _fly(campaign, folder, out / "models", workers)
    _report(list(campaigns), begun, as_json)


def _check_ledger(campaign: "Campaign", out: Path) -> None:
    """Refuse a folder with another campaign before anything is trained or written there.

    Raises:
        BadInputError: It holds another campaign, or what is no ledger.
    """
    from mavfi.campaign.run import campaign_scenarios
    from mavfi.campaign.store import FILE, Store
    from mavfi.campaign.tools import host_tools

    if not (out / FILE).is_file():
        return
    with Store.open(out) as store:
        held = store.meta("identity")
    scenarios = campaign_scenarios(campaign, host_tools())
    wanted = {
        "campaign": campaign.to_json(),
        "scenarios": {name: scenario.to_json() for name, scenario in scenarios.items()},
    }
    differing = [key for key, value in wanted.items() if held.get(key) != value]
    if differing:
        raise BadInputError(
            f"{out}: holds another campaign (differs in: {', '.join(differing)}); choose another directory"
        )


def _train(campaign: "Campaign", folder: Path, workers: int) -> None:
    from mavfi.campaign.training import train
    from mavfi.cli.progress import Bar

    with Bar("training flights") as bar:
        train(
            folder, TRAINING_FLIGHTS, stack=campaign.stack, platform=campaign.platform, planner=campaign.planner,
            v_max=campaign.v_max, workers=workers, progress=bar.show,
        )  # fmt: skip


def _trained(campaign: "Campaign", folder: Path) -> bool:
    """Whether the folder holds the models that training would give."""
    from mavfi.campaign.run import versions
    from mavfi.detectors.model import Model

    here = versions()
    wanted = {"stack": campaign.stack, "platform": campaign.platform, "planner": campaign.planner,
              "flights": TRAINING_FLIGHTS}  # fmt: skip
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
    return all((arm.detector, arm.profile) in held for arm in campaign.detectors.values())


def _fly(campaign: "Campaign", folder: Path, models: Path, workers: int) -> None:
    from mavfi.campaign.run import run_campaign
    from mavfi.cli.progress import Bar

    with Bar(f"{campaign.name}, {campaign.flights} missions per environment") as bar:
        run_campaign(campaign, folder, workers=workers, models_dir=models, progress=bar.show_campaign)


def _report(folders: list[Path], begun: float, as_json: bool) -> None:
    """Write the report of each level, print them one after the other; as JSON the second is inside the first."""
    from mavfi.cli.progress import duration
    from mavfi.reports.campaign_report import write_report
    from mavfi.reports.terminal import show

    text = console()
    written = []
    for folder in folders:
        written.append(write_report(folder, shown=None if as_json else lambda analysis: show(analysis, text)))
    states, instructions = written
    if as_json:
        write_json({**states.analysis, INSTRUCTIONS_FOLDER: instructions.analysis})
        return
    text.print()
    for folder, report in zip(folders, written, strict=True):
        text.print(f"[bold]{folder}[/bold] holds the ledger, and: {', '.join(path.name for path in report.files)}")
    text.print(f"The models are in {folders[0] / 'models'}. It took {duration(time.perf_counter() - begun)}.")
