"""`mavfi reproduce`: train the detectors, fly the paper's table, print and write the report."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mavfi.cli.console import JSON_HELP, check_folder, console, write_json
from mavfi.cli.stopping import stoppable
from mavfi.errors import BadInputError

if TYPE_CHECKING:
    from mavfi.campaign.config import Campaign

TRAINING_FLIGHTS = 100
_CAMPAIGN = "table1"


def reproduce(
    scale: Annotated[str, typer.Option(help="quick: 30 missions per environment; paper: 100.")] = "quick",
    out: Annotated[Path, typer.Option(help="Folder of everything that is written.")] = Path("out/reproduce"),
    workers: Annotated[int, typer.Option(help="Processes; the result does not depend on them.")] = 2,
    as_json: Annotated[bool, typer.Option("--json", help=JSON_HELP)] = False,
) -> None:
    """Train the detectors, fly the paper's success table, print it, write the report.

    Ctrl-C stops (exit code 130); the same command goes on where it stopped.

    Example: [bold]mavfi reproduce --scale quick --out out/reproduce[/bold]
    """
    from mavfi.campaign.config import load_campaign
    from mavfi.campaign.executors.local import LocalPool
    from mavfi.cli.progress import import_host

    begun = time.perf_counter()
    campaign = load_campaign(_CAMPAIGN).at_scale(scale)
    LocalPool(workers)  # refuses a number that is none
    _check_ledger(campaign, out)
    check_folder(out)
    trained = _trained(campaign, out / "models")
    import_host(training=not trained)
    with stoppable(f"Stopped. What is done is kept in {out}; the same command goes on."):
        if not trained:
            _train(campaign, out / "models", workers)
        _fly(campaign, out, workers)
    _report(out, begun, as_json)


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


def _fly(campaign: "Campaign", out: Path, workers: int) -> None:
    from mavfi.campaign.run import run_campaign
    from mavfi.cli.progress import Bar

    with Bar(f"{campaign.name}, {campaign.flights} missions per environment") as bar:
        run_campaign(campaign, out, workers=workers, models_dir=out / "models", progress=bar.show_campaign)


def _report(out: Path, begun: float, as_json: bool) -> None:
    from mavfi.cli.progress import duration
    from mavfi.reports.campaign_report import write_report
    from mavfi.reports.terminal import show

    text = console()

    def tell(analysis: dict[str, Any]) -> None:
        if as_json:
            write_json(analysis)
        else:
            show(analysis, text)

    written = write_report(out, shown=tell)
    if as_json:
        return
    text.print(f"\n[bold]{out}[/bold] holds the ledger, the models, and: {', '.join(p.name for p in written.files)}")
    text.print(f"It took {duration(time.perf_counter() - begun)}.")
