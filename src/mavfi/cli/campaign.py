"""`mavfi campaign run | status | verify | merge | repair | digest`: fly many missions, verify the results."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mavfi.campaign.executors.local import LocalExecutor
from mavfi.cli import options
from mavfi.cli.console import check_name, check_seed, console, write_json
from mavfi.cli.stopping import stoppable
from mavfi.errors import BadInputError, MavfiError
from mavfi.plugins import known, load_object

if TYPE_CHECKING:
    from mavfi.campaign.executors.executor import Executor

app = typer.Typer(
    help="Fly a campaign, see how far it is, prove what came out.\n\n"
    "Example: [bold]mavfi campaign run smoke --out out/smoke[/bold]",
    no_args_is_help=False,
)


@app.command("run")
def run(  # noqa: PLR0913 - options
    config: Annotated[
        str, typer.Argument(metavar="CONFIG.yaml", help="A YAML file, or the name of a shipped campaign.")
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
    allow_unknown: Annotated[
        bool, typer.Option("--allow-unknown", help="Exit with 0 even if runs have status unknown.")
    ] = False,
) -> None:
    """Fly a campaign, or its missing runs.  Ctrl-C stops it (exit code 130); the same command resumes.

    Example: [bold]mavfi campaign run configs/campaigns/states.yaml --out out/states[/bold]
    """
    from mavfi.campaign.config import load_campaign
    from mavfi.campaign.mission import check_names
    from mavfi.campaign.plan import WHOLE, Shard
    from mavfi.campaign.run import run_campaign
    from mavfi.cli.progress import Bar, success_counts

    # check all options before the first flight
    campaign = load_campaign(config).at_scale(scale)
    check_names(campaign, config)
    ledger = out or Path("out") / campaign.name
    chosen_executor = _executor(executor, scheduler, workers)
    chosen_shard = Shard.parse(shard, "--shard")
    # fly what is missing
    stop_message = f"Stopped. What is done is kept in {ledger}; the same command resumes."
    with stoppable(stop_message), Bar(f"campaign {campaign.name}", "runs") as bar:
        status = run_campaign(
            campaign,
            ledger,
            executor=chosen_executor,
            models_dir=models,
            fast_forward=fast_forward,
            shard=chosen_shard,
            progress=bar.show_campaign,
        )
    # report; unknown runs first, they make the figures incomplete
    if status.unknown and not allow_unknown:
        raise MavfiError(
            f"{ledger}: {status.unknown} of {status.total} runs have status unknown{_most_frequent_reason(ledger)}: "
            f"`mavfi runs {ledger} --failed` lists them with the reason; --allow-unknown accepts them"
        )
    if chosen_shard != WHOLE:
        text = (
            f"Done with shard {chosen_shard}. To join all: [bold]mavfi campaign merge DIR ... --out {ledger}-all[/bold]"
        )
        console().print(text, soft_wrap=True)
        return
    console().print(success_counts(status.settings))
    console().print(f"Done. Tables and figures: [bold]mavfi report {ledger}[/bold]", soft_wrap=True)


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
) -> None:
    """Print the progress of a campaign, and the number of successful missions in each setting.

    Example: [bold]mavfi campaign status out/states[/bold]
    """
    from mavfi.campaign.ledger import status as status_of
    from mavfi.campaign.plan import WHOLE
    from mavfi.cli.progress import success_counts

    progress = status_of(directory)
    if as_json:
        keys = ("planned", "flown", "succeeded")
        settings = {name: dict(zip(keys, counts, strict=True)) for name, counts in progress.settings.items()}
        write_json({**asdict(progress), "complete": progress.complete, "settings": settings})
        return
    text = f"{progress.done} of {progress.total} runs"
    if progress.shard != WHOLE:
        text += f" of shard {progress.shard}"
    if progress.complete:
        text += ", complete"
    console().print(text)
    console().print(success_counts(progress.settings))


@app.command("verify")
def verify(
    directory: options.Ledger,
    share: Annotated[float, typer.Option(help="Sample size; 1 = all runs.")] = 0.02,
    seed: Annotated[int, typer.Option(help="Seed of the sample.")] = 0,
    as_json: options.AsJson = False,
) -> None:
    """Replay a random sample of the runs, compare their records, and bound the share of wrong records.

    Exit code 1 if a record differs.

    Example: [bold]mavfi campaign verify out/states --share 0.05[/bold]
    """
    from mavfi.campaign.replay import verify as verify_runs
    from mavfi.cli.progress import Bar

    check_seed("--seed", seed)
    with Bar("replay", "runs") as bar:
        sample = verify_runs(directory, share, seed, bar.show)
    bound = f"at most {100 * sample.upper_bound:.2g} % of the {sample.runs} records are wrong (95 % confidence)"
    if as_json:
        write_json({**asdict(sample), "upper_bound": sample.upper_bound})
    elif not sample.differing:
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
    typer.echo(text)
    if progress.shard != WHOLE:
        console(error=True).print(f"partial: shard {progress.shard} of the campaign")
    if not progress.complete:
        remark = f"partial: {progress.done} of {progress.total} runs are flown; the rest will change this digest"
        console(error=True).print(remark)
