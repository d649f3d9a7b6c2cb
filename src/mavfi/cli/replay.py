"""`mavfi replay`: repeat a stored run, and compare its digest."""

from rich.text import Text

from mavfi.cli import options
from mavfi.cli.console import console, write_json
from mavfi.errors import MavfiError


def replay(directory: options.Ledger, run_id: options.RunId, as_json: options.AsJson = False) -> None:
    """Replay a run from its specification, and report whether the digest is the same.

    Exit code 1 if it is another run.

    Example: [bold]mavfi replay out/reproduce sparse-10003-golden-[/bold]
    """
    from mavfi.campaign.replay import replay as fly_again

    found = fly_again(directory, run_id)
    record, stored = found.record, found.run.record
    injections = () if stored is None else stored.injections
    replayable = all(injection.details.get("replayable", True) for injection in injections)
    ended = record.status.replace("_", " ") or record.error
    if as_json:
        write_json({
            "run_id": found.run.spec.run_id, "same": found.same, "digest": record.digest,
            "stored_digest": None if stored is None else stored.digest, "status": record.status,
            "stored_status": None if stored is None else stored.status, "replayable": replayable,
            "flight_time_s": record.flight_time_s,
        })  # fmt: skip
    else:
        console().print(Text.assemble((found.run.spec.run_id, "bold"), f": {ended}"), soft_wrap=True)
    if not found.same:
        held = "none" if stored is None else stored.digest or stored.error
        why = "bits are the same only with the same lock file, on x86-64 Linux"
        if not replayable:
            why = "not replayable: the fault was in a live process, or in a kernel whose memory belongs to a library"
        raise MavfiError(f"{directory}: another run: {record.digest or 'no flight'}; stored: {held}; {why}")
    if not as_json:
        console().print(
            Text.assemble(("✓", "green"), f" the same run, bit for bit: {record.digest or 'no flight, as stored'}")
        )
