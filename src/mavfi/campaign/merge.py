"""Merging of shard ledgers into the campaign's ledger, with the digest of the undivided campaign."""

from collections.abc import Sequence
from itertools import islice
from pathlib import Path

from mavfi.campaign.fingerprint import differences
from mavfi.campaign.run import ORDERED, check_shard, check_versions, status, stored_campaign
from mavfi.campaign.session import Status
from mavfi.campaign.shard import WHOLE
from mavfi.campaign.store import Store
from mavfi.errors import BadInputError
from mavfi.record import without_source

_ROWS = 1000  # per transaction


def merge(sources: Sequence[Path], out: Path) -> Status:
    """Copy all runs of several ledgers of one campaign, complete or not, in any order, into a new or existing one.

    Raises:
        BadInputError: A ledger is absent or damaged, belongs to another campaign or to one with another order of keys,
            was started with other versions, or has a record that conflicts with another ledger's.
    """
    _check_alike(sources)
    for directory in sources:
        with Store.open(directory) as source, Store.create(out, source.meta("identity")) as target:
            check_shard(target, WHOLE)
            check_versions(target, source.meta("versions"), f"{directory} with")
            if target.meta(ORDERED) not in (None, source.meta(ORDERED)):
                raise BadInputError(f"{directory}: holds the campaign with its keys in another order than {out}")
            models = source.models_dir
            target.write_meta({
                ORDERED: source.meta(ORDERED), "models_dir": models and str(models.absolute()),
                "missions": stored_campaign(source).total_missions,
            })  # fmt: skip
            _copy(source, target)
    return status(out)


def _check_alike(sources: Sequence[Path]) -> None:
    """Raise a BadInputError if ledgers are not of one campaign, before anything is written."""
    identities = {}
    for directory in sources:
        with Store.open(directory) as source:
            identities[directory] = source.meta("identity")
    for directory, identity in identities.items():
        if identity != identities[sources[0]]:
            differing = differences(identities[sources[0]], identity)
            raise BadInputError(f"{directory}: holds another campaign than {sources[0]} (differs in: {differing})")


def _copy(source: Store, target: Store) -> None:
    every = source.rows()
    while rows := list(islice(every, _ROWS)):
        flown = [item for _, item in rows if item is not None]
        for item in flown:
            known = target.record_text(item.run_id)
            if known is not None and without_source(known) != without_source(item.text):
                raise BadInputError(
                    f"{source.directory}: run {item.run_id!r}: has another record than in {target.directory}"
                )
        target.plan(row for row, _ in rows)
        target.write(flown)
    for world in source.planned():
        target.end_plan(world)
