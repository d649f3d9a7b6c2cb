"""Ledgers of shards -> the ledger of the campaign, with the digest that it would have if nobody had split it."""

from collections.abc import Sequence
from itertools import islice
from pathlib import Path

from mavfi.campaign.run import SHARD, Status, status, stored_campaign
from mavfi.campaign.store import Store
from mavfi.errors import BadInputError

_ROWS = 1000  # of one transaction


def merge(sources: Sequence[Path], out: Path) -> Status:
    """Copy all runs of some ledgers of one campaign, complete or not, in any order, into one that may exist already.

    Raises:
        BadInputError: A ledger is absent, damaged or of another campaign, was begun with other versions, or has a
            record of a run that differs from another ledger's.
    """
    for directory in sources:
        with Store.open(directory) as source:
            campaign, held, models = stored_campaign(source), source.meta("versions"), source.models_dir
            with Store.create(out, source.meta("identity")) as target:
                merged = target.meta("versions")
                if merged not in (None, held):
                    name = next(name for name in held if merged.get(name) != held[name])
                    raise BadInputError(
                        f"{directory}: was flown with {name} {held[name]}, others with {merged.get(name)}; runs cannot "
                        "be mixed"
                    )
                target.write_meta({
                    "versions": held, "models_dir": models and str(models.absolute()),
                    "campaign": source.meta("campaign"), "missions": campaign.total_missions,
                    SHARD: (1, 1),
                })  # fmt: skip
                _copy(source, target)
    return status(out)


def _copy(source: Store, target: Store) -> None:
    every = source.rows()
    while rows := list(islice(every, _ROWS)):
        for _, flown in rows:
            there = None if flown is None else target.record_text(flown.run_id)
            if flown is not None and there not in (None, flown.text):
                raise BadInputError(
                    f"{source.directory}: run {flown.run_id!r}: has another record than in {target.directory}"
                )
        target.plan(row for row, _ in rows)
        target.write(flown for _, flown in rows if flown is not None)
    for world in source.planned():
        target.end_plan(world)
