"""`mavfi campaign run | status | verify | merge | repair | digest`: fly many missions, verify the results."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mavfi.campaign.executors.local import LocalExecutor
from mavfi.cli import completion, options
from mavfi.cli.console import answer, check_name, check_seed, check_writable, console, write_json
from mavfi.cli.stopping import stoppable
from mavfi.errors import BadInputError, MavfiError
from mavfi.files import is_file
from mavfi.plugins import known, load_object, use_ledger
from mavfi.report.numbers import upper_percent

if TYPE_CHECKING:
    from mavfi.analysis.requirements import RequirementVerdict
    from mavfi.campaign.config import Campaign
    from mavfi.campaign.executors.executor import Executor
    from mavfi.campaign.ledger import Status
    from mavfi.campaign.requirement import Requirement

HELP_PANEL = "Campaigns"
EXIT_REQUIREMENT = 3
"""Exit code if a requirement does not hold, or too few runs show that it does."""
_LOOSE_BOUND = 0.1
"""Share of wrong records above which a verification hardly says anything."""
Junit = Annotated[
    Path | None, typer.Option(metavar="FILE.xml", help="Write the requirements as test cases, in JUnit's format.")
]

app = typer.Typer(
    help="Fly a campaign, see how far it is, prove what came out.\n\n"
    "Example: [bold]mavfi campaign run smoke --out out/smoke[/bold]",
    no_args_is_help=False,
)


@app.command("run")
def run(  # noqa: PLR0913 - options
    context: typer.Context,
    config: Annotated[
        str,
        typer.Argument(
            metavar="CONFIG.yaml",
            help="A YAML file, or the name of a shipped campaign.",
            autocompletion=completion.of_configs("campaigns"),
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder of the ledger; made if absent, resumed if it holds this campaign.  out/<name> by default."
        ),
    ] = None,
    workers: options.Workers = 2,
    executor: Annotated[
        str, typer.Option(help="local: processes of this machine, or dask: the workers of a Dask scheduler.")
    ] = "local",
    scheduler: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS", help="Of the Dask scheduler, e.g. tcp://10.0.0.1:8786; otherwise a cluster here."
        ),
    ] = "",
    shard: Annotated[
        str, typer.Option(metavar="I/N", help="Only every N-th mission, from the I-th on; `merge` joins the ledgers.")
    ] = "1/1",
    scale: Annotated[str, typer.Option(help="quick, or another size that the campaign names, e.g. paper.")] = "quick",
    models: options.Models = None,
    fast_forward: Annotated[
        bool,
        typer.Option(
            "--fast-forward/--no-fast-forward",
            help="Begin injected runs at checkpoints of their golden run; the result does not depend on it.",
        ),
    ] = True,
    extend: Annotated[
        bool,
        typer.Option("--extend", help="Keep the runs of a smaller campaign in --out: fly what CONFIG has in addition."),
    ] = False,
    allow_unknown: Annotated[
        bool, typer.Option("--allow-unknown", help="Exit with 0 even if runs have status unknown.")
    ] = False,
    require: options.Require = None,
    junit: Junit = None,
) -> None:
    """Fly a campaign, or its missing runs.  Ctrl-C stops it (exit code 130); the same command resumes.

    Exit code 3: a requirement, of --require or of the key `require`, does not hold.

    Example: [bold]mavfi campaign run configs/campaigns/states.yaml --out out/states[/bold]
    """
    from mavfi.campaign.begin import begin, check_names, check_null_runs
    from mavfi.campaign.config import load_campaign
    from mavfi.campaign.plan import WHOLE, Shard
    from mavfi.campaign.run import run_campaign
    from mavfi.campaign.store import FILE, IDENTITY, read_meta
    from mavfi.report.progress import Bar

    # check all options before the first flight
    campaign = load_campaign(config).at_scale(scale)
    ledger = out or Path("out") / campaign.name
    use_ledger(ledger, read_meta(ledger, IDENTITY))  # a resumed campaign has been allowed to run its plug-ins
    check_names(campaign, config)
    check_null_runs(campaign, ledger)
    requirements = _requirements(campaign, [*campaign.require, *(require or ())], junit)
    if extend and not is_file(ledger / FILE):
        raise BadInputError(f"--extend: {ledger} holds no campaign; allowed: the folder of one, or without --extend")
    if scheduler and options.is_users(context.get_parameter_source("workers")):
        raise BadInputError(f"--workers: {workers}: a scheduler has its own workers; allowed: without --scheduler")
    chosen_executor = _executor(executor, scheduler, workers)
    chosen_shard = Shard.parse(shard, "--shard")
    if chosen_shard != WHOLE and (require or junit):
        raise BadInputError(f"--shard {shard}: is a part; allowed: --require and --junit with `campaign status` of all")
    # fly what is missing
    stop_message = f"Stopped. What is done is kept in {ledger}; the same command resumes."
    with stoppable(stop_message), Bar(f"campaign {campaign.name}", "runs") as bar:
        begun = begin(campaign, ledger, models_dir=models, extend=extend)
        status = run_campaign(
            begun,
            ledger,
            executor=chosen_executor,
            fast_forward=fast_forward,
            shard=chosen_shard,
            extend=extend,
            progress=bar.show_campaign,
        )
    # report; unknown runs first, they make the figures incomplete
    if status.unknown and not allow_unknown:
        raise MavfiError(
            f"{ledger}: {status.unknown} of {status.total} runs have status unknown{_most_frequent_reason(ledger)}: "
            f"`mavfi runs {ledger} --failed` lists them with the reason; --allow-unknown accepts them"
        )
    if begun.host.deterministic:
        _check_null_runs(ledger)
    if chosen_shard != WHOLE:
        text = (
            f"Done with shard {chosen_shard}. To join all: [bold]mavfi campaign merge DIR ... --out {ledger}-all[/bold]"
        )
        console().print(text, soft_wrap=True)
        return
    verdicts = _judge(ledger, campaign.name, requirements, junit)
    show_verdicts(verdicts)
    _show_counts(ledger, status)
    console().print(f"Done. Tables and figures: [bold]mavfi report {ledger}[/bold]", soft_wrap=True)
    exit_unless_all_hold(verdicts)


def _requirements(campaign: "Campaign", texts: Sequence[str], junit: Path | None) -> "list[Requirement]":
    """Requirements on a campaign, checked before its first flight."""
    try:
        requirements = campaign.requirements(texts)
    except BadInputError as error:
        raise BadInputError(f"--require: {error}") from None
    if junit is not None and not requirements:
        raise BadInputError(f"--junit: {junit}: there is no test case; allowed: with --require, or the key require")
    check_writable(junit)
    return requirements


def _judge(
    directory: Path, name: str, requirements: "Sequence[Requirement]", junit: Path | None
) -> "list[RequirementVerdict]":
    """Judge requirements by the runs of a ledger, and write the verdicts if a file is given."""
    if not requirements:
        return []
    from mavfi.analysis.requirements import judge, write_junit
    from mavfi.analysis.runs import Runs

    verdicts = judge(Runs.read(directory), requirements)
    if junit is not None:
        write_junit(junit, name, verdicts)
    return verdicts


def show_verdicts(verdicts: "Sequence[RequirementVerdict]") -> None:
    """Print one line per requirement."""
    for verdict in verdicts:
        console().print(verdict.line, markup=False, soft_wrap=True)


def exit_unless_all_hold(verdicts: "Sequence[RequirementVerdict]") -> None:
    """Exit with the code of requirements unless each is shown to hold."""
    if not verdicts:
        return
    from mavfi.analysis.requirements import Holds

    if any(verdict.holds is not Holds.YES for verdict in verdicts):
        raise typer.Exit(EXIT_REQUIREMENT)


def _show_counts(directory: Path, status: "Status") -> None:
    """Print how flights ended by setting; of runs that are no flights, the effects of their faults."""
    from mavfi.report.progress import effect_counts, run_counts

    if not status.flies:
        from mavfi.analysis.effects import effect_rates
        from mavfi.analysis.runs import Runs

        effects = effect_rates(Runs.read(directory))
        if effects:
            console().print(effect_counts(effects))
            return
    console().print(run_counts(status.settings, flies=status.flies))


def _executor(name: str, scheduler: str, workers: int) -> "Executor":
    """What flies the runs: processes of this machine, or an executor that an extra adds by an entry point."""
    extras = sorted(known("mavfi.executors", {}))
    check_name("--executor", name, ("local", *extras))
    if name != "local":
        executor: Executor = load_object("executor", name, "mavfi.executors", {})(scheduler, workers)
        return executor
    if scheduler:
        raise BadInputError(f"--scheduler: {scheduler}: allowed with --executor {', '.join(extras)}")
    return LocalExecutor(workers)


def _check_null_runs(ledger: Path) -> None:
    """Refuse to report a campaign whose null runs differ from their golden runs: its faults have no effect to tell."""
    from mavfi.campaign.store import Store

    with Store.open(ledger) as store:
        differing = store.differing_null_runs()
    if differing:
        raise MavfiError(
            f"{ledger}: {len(differing)} null runs differ from their golden runs, in the flight or in their alarms, so "
            f"no effect of a fault can be told: {', '.join(differing[:5])}"
        )


def _most_frequent_reason(ledger: Path) -> str:
    """The most frequent reason of status unknown, with its number of runs, in brackets."""
    from mavfi.campaign.store import Store

    with Store.open(ledger) as store:
        ((reason, number),) = store.unknown().most_common(1)
    return f" ({number} of them: {reason})"


@app.command("status")
def status(
    directory: options.Ledger,
    as_json: options.AsJson = False,
    require: options.Require = None,
    junit: Junit = None,
) -> None:
    """Print the progress of a campaign, and in each setting the number of successful missions, or effects of faults.

    Exit code 3: a requirement does not hold.

    Example: [bold]mavfi campaign status out/states --require 'success >= 90 %'[/bold]
    """
    from mavfi.campaign.ledger import status as status_of
    from mavfi.campaign.ledger import stored_campaign
    from mavfi.campaign.plan import WHOLE
    from mavfi.campaign.store import Store

    progress = status_of(directory)
    verdicts: list[RequirementVerdict] = []
    if require or junit:
        with Store.open(directory) as store:
            campaign = stored_campaign(store)
        verdicts = _judge(directory, campaign.name, _requirements(campaign, require or (), junit), junit)
    if as_json:
        data = {**asdict(progress), "complete": progress.complete, "settings": _settings(directory, progress)}
        if verdicts:
            data["requirements"] = [verdict.to_json() for verdict in verdicts]
        write_json(data)
        exit_unless_all_hold(verdicts)
        return
    show_verdicts(verdicts)
    text = f"{progress.done} of {progress.total} runs"
    if progress.shard != WHOLE:
        text += f" of shard {progress.shard}"
    if progress.complete:
        text += ", complete"
    else:
        text += f"; `mavfi campaign run CONFIG --out {directory}` flies the rest"
    console().print(text, markup=False, soft_wrap=True)
    _show_counts(directory, progress)
    exit_unless_all_hold(verdicts)


def _settings(directory: Path, status: "Status") -> dict[str, dict[str, Any]]:
    """Counts by setting as plain data: successful flights, or effects of faults where runs are no flights."""
    settings: dict[str, dict[str, Any]] = {}
    for name, (planned, done, success) in status.settings.items():
        settings[name] = {"planned": planned, "flown": done}
        if status.flies:
            settings[name]["succeeded"] = success
    if not status.flies:
        from mavfi.analysis.effects import effect_rates
        from mavfi.analysis.runs import Runs

        for name, rates in effect_rates(Runs.read(directory)).items():
            settings[name]["effects"] = {effect: asdict(rate) for effect, rate in rates.items()}
    return settings


@app.command("verify")
def verify(
    directory: options.Ledger,
    share: Annotated[float, typer.Option(help="Share of the runs that is replayed; 1 = all.")] = 0.02,
    seed: Annotated[int, typer.Option(help="Seed of the sample.")] = 0,
    as_json: options.AsJson = False,
) -> None:
    """Replay a random sample of the runs, compare their records, and bound the share of wrong records.

    Exit code 1 if a record differs.

    Example: [bold]mavfi campaign verify out/states --share 0.05[/bold]
    """
    from mavfi.campaign.replay import verify as verify_runs
    from mavfi.report.progress import Bar

    check_seed("--seed", seed)
    with Bar("replay", "runs") as bar:
        sample = verify_runs(directory, share, seed, bar.show)
    bound = f"at most {upper_percent(sample.upper_bound)} of the {sample.runs} records are wrong (95 % confidence)"
    if as_json:
        write_json({**asdict(sample), "upper_bound": sample.upper_bound})
    elif not sample.differing:
        if sample.flown < sample.runs and sample.upper_bound > _LOOSE_BOUND:
            bound += "; a larger --share shows more"
        console().print(f"{sample.flown} of {sample.runs} runs replayed, all records equal; {bound}")
    if sample.differing:
        raise MavfiError(
            f"{directory}: {len(sample.differing)} of {sample.flown} replayed runs have another record: "
            f"{', '.join(sample.differing[:5])}; {bound}"
        )


@app.command("merge")
def merge(
    directories: Annotated[list[Path], typer.Argument(metavar="DIR...", help="Folders of the ledgers.")],
    out: Annotated[Path, typer.Option(help="Folder of the ledger of all; made if absent.")],
) -> None:
    """Merge the ledgers of a campaign's shards (`campaign run --shard`), in any order.

    Example: [bold]mavfi campaign merge out/part-* --out out/states[/bold]
    """
    from mavfi.campaign.ledger import merge as merge_ledgers

    progress = merge_ledgers(directories, out)
    next_step = f"complete. Tables and figures: [bold]mavfi report {out}[/bold]"
    if not progress.complete:
        next_step = f"`mavfi campaign run CONFIG --out {out}` flies the rest"
    console().print(f"{progress.done} of {progress.total} runs; {next_step}", soft_wrap=True)


@app.command("repair")
def repair(directory: options.Ledger) -> None:
    """Keep the intact runs of a damaged ledger; `mavfi campaign run` then flies the missing ones.

    Example: [bold]mavfi campaign repair out/states[/bold]
    """
    from mavfi.campaign.ledger import DAMAGED
    from mavfi.campaign.ledger import repair as repair_ledger

    repaired = repair_ledger(directory)
    if repaired.was_intact:
        text = f"{repaired.intact} runs, none damaged: nothing to repair, the ledger is as it was"
        console().print(text, soft_wrap=True)
        return
    console().print(
        f"{repaired.intact} runs kept, {repaired.lost} damaged. Resume the campaign to fly the missing ones. "
        f"Backup of the damaged file: {directory / DAMAGED}",
        soft_wrap=True,
    )


@app.command("digest")
def digest(directory: options.Ledger, as_json: options.AsJson = False) -> None:
    """Print the hash of plan and records, independent of the number of workers and of interruptions.

    For an incomplete campaign it covers the runs so far, with a message on stderr.

    Example: [bold]mavfi campaign digest out/states[/bold]
    """
    from mavfi.campaign.ledger import status as status_of
    from mavfi.campaign.plan import WHOLE
    from mavfi.campaign.store import Store

    with Store.open(directory) as store:
        text = store.digest()
    progress = status_of(directory)
    if as_json:
        partial = not progress.complete or progress.shard != WHOLE
        write_json({"digest": text, "partial": partial, "done": progress.done, "total": progress.total})
        return
    answer(text)
    if progress.shard != WHOLE:
        console(error=True).print(f"partial: shard {progress.shard} of the campaign")
    if not progress.complete:
        remark = f"partial: {progress.done} of {progress.total} runs are flown; the rest will change this digest"
        console(error=True).print(remark)
