"""A ledger becomes that of a larger campaign: more missions, faults, null runs, environments or arms.

What is flown stays: ids, seeds and records.  Only positions change, which number the runs of the whole campaign.  The
larger campaign must therefore draw the same faults where the smaller one has drawn any.  So it keeps the size of the
smaller one in its key `grown`, and the further faults are a batch of their own, see `levels.level.Batch`.  Its ledger,
once the missing runs are flown, is that of the campaign with this key flown from the start.  Null runs, which take the
arms in turn and only check the injector, are the exception: with further arms, those of the larger campaign take their
place.
"""

import json
from collections.abc import Mapping
from typing import Any, NamedTuple

from mavfi.campaign.config import Campaign
from mavfi.campaign.ledger import stored_campaign
from mavfi.campaign.plan import Plan, Row, RunSpec, Shard
from mavfi.campaign.resolve import resolve
from mavfi.campaign.store import Store
from mavfi.errors import BadInputError
from mavfi.levels.level import NULL, Draw

_MAY_GROW = ("missions", "faults", "grown", "null_runs", "environments", "arms", "parts", "scales")
"""Keys of a campaign that may differ in an extension; `scales` name sizes, and do not matter to the runs."""
_ALLOWED = "allowed with --extend: more missions, faults, null_runs, environments and arms"


def differ_in_size(stored_identity: Mapping[str, Any], identity: Mapping[str, Any]) -> bool:
    """Whether two campaigns differ only in what may grow."""
    stored_keys = stored_identity["campaign"]
    keys = identity["campaign"]
    return all(stored_keys.get(key) == keys.get(key) or key in _MAY_GROW for key in {*stored_keys, *keys})


def as_grown(stored: Campaign, campaign: Campaign, *, extend: bool) -> Campaign:
    """A campaign of the user with the sizes that it has had in a ledger.

    Args:
        stored: The campaign of the ledger.
        campaign: That of the user, of the same or another size.
        extend: Whether it may be larger than that of the ledger.
    """
    if campaign.grown:
        return campaign
    grown = stored.grown
    if campaign.sizes[-1] != stored.sizes[-1]:
        is_larger = campaign.missions >= stored.missions and campaign.faults >= stored.faults
        if not (extend and is_larger):
            return campaign
        grown = stored.sizes
    return campaign.model_copy(update={"grown": grown})


def extend_ledger(store: Store, plan: Plan, identity: Mapping[str, Any], shard: Shard) -> None:
    """Turn a ledger into that of a larger campaign, in one transaction; its missing runs remain to be flown.

    Args:
        store: The ledger, open for writing.
        plan: Plan of the larger campaign.
        identity: Identity of the larger campaign.
        shard: Shard of the ledger.

    Raises:
        BadInputError: The campaign does not extend the stored one; the message names the key.
    """
    stored = stored_campaign(store)
    stored_plan = Plan(resolve(stored))  # only what its runs are, not where they are flown
    extension = _Extension(str(store.directory), stored_plan, plan)
    extension.check_keys(store.meta("identity"), identity)
    extension.check_draws()

    missions_of_shard = set(shard.worlds(plan.campaign.config))
    rows = []
    unflown = set()
    replaced = []
    for row, _ in store.rows():
        spec = RunSpec.from_json(json.loads(row.text))
        if spec.world not in missions_of_shard:
            text = f"shard {shard} would have other missions; allowed: to extend the merged ledger"
            raise extension.refusal("missions", text)
        new_row = extension.row_of(spec)
        if new_row is None:
            replaced.append(row.run_id)
            continue
        rows.append(new_row)
        if spec.kind == "golden" and extension.counts_now(spec):
            unflown.add(row.run_id)
    unchanged = [world for world in store.planned() if extension.adds_nothing_to(*world)]
    store.replan(identity, rows, unchanged, unflown, replaced)


class _MissionDraws(NamedTuple):
    """The draws of a mission in two plans; in the larger one, their positions by target and number of the fault."""

    stored: list[Draw]
    extended: list[Draw]
    positions: dict[tuple[str, int], tuple[int, Draw]]


class _Extension:
    """Two plans, of which the second one is to have all runs of the first.

    Args:
        directory: Folder of the ledger, for messages.
        stored: The plan of the ledger.
        extended: The plan of the larger campaign.
    """

    def __init__(self, directory: str, stored: Plan, extended: Plan) -> None:
        self._directory = directory
        self._stored = stored
        self._extended = extended
        self._draws: dict[tuple[str, int], _MissionDraws] = {}

    def refusal(self, key: str, text: str) -> BadInputError:
        """The error that names a key of the campaign."""
        return BadInputError(f"{self._directory}: cannot be extended: key {key!r}: {text}")

    def check_keys(self, stored_identity: Mapping[str, Any], identity: Mapping[str, Any]) -> None:
        """Refuse a campaign that is smaller, or differs in what must stay.

        Raises:
            BadInputError: The message names the key.
        """
        stored_keys = stored_identity["campaign"]
        keys = identity["campaign"]
        if not differ_in_size(stored_identity, identity):
            changed = {key for key in {*stored_keys, *keys} - {*_MAY_GROW} if stored_keys.get(key) != keys.get(key)}
            raise self.refusal(min(changed), f"differs from the ledger's; {_ALLOWED}")
        self._check_sizes(self._stored.campaign.config, self._extended.campaign.config)
        for key in ("arms", "parts"):
            self._check_members(key, stored_keys.get(key, {}), keys.get(key, {}))

        # Scenarios, models and options are those of files, which may have changed since.
        for key in sorted({*stored_identity, *identity} - {"campaign"}):
            self._check_members(key, stored_identity.get(key, {}), identity.get(key, {}))

    def _check_sizes(self, stored: Campaign, extended: Campaign) -> None:
        """Refuse fewer missions, faults or null runs, and environments that are missing."""
        for key, least, number in (
            ("missions", stored.missions, extended.missions),
            ("faults", stored.faults, extended.faults),
            ("null_runs", stored.nulls, extended.nulls),
        ):
            if number < least:
                raise self.refusal(key, f"{number}; the ledger has {least}; allowed: {least} or more")
        if extended.sizes[: len(stored.sizes)] != stored.sizes:
            raise self.refusal("grown", "lacks a size that the ledger has had; allowed: without this key")
        missing = [name for name in stored.environments if name not in extended.environments]
        if missing:
            raise self.refusal("environments", f"lacks {', '.join(missing)}, which the ledger has; {_ALLOWED}")

    def _check_members(self, key: str, stored: Mapping[str, Any], extended: Mapping[str, Any]) -> None:
        """Refuse members of a key that are missing or differ."""
        for name, value in stored.items():
            if name not in extended:
                raise self.refusal(key, f"lacks {name}, which the ledger has; {_ALLOWED}")
            if extended[name] != value:
                raise self.refusal(f"{key}.{name}", f"differs from the ledger's; {_ALLOWED}")

    def check_draws(self) -> None:
        """Refuse a campaign that would draw other faults in place of those that are flown.

        Raises:
            BadInputError: The message names the key on which the draws depend.
        """
        before = self._stored.campaign.sampler
        now = self._extended.campaign.sampler
        for environment in self._stored.campaign.config.environments:
            for stored_block, block in zip(before.blocks(environment), now.blocks(environment), strict=False):
                for index in range(stored_block.count):
                    draw = stored_block.draw(index)
                    new_draw = block.draw(index)
                    if before.basis(environment, draw) == now.basis(environment, new_draw):
                        continue
                    raise self.refusal(
                        "faults",
                        f"{self._extended.campaign.config.faults}: the faults of a mission are drawn together: with "
                        f"more of them, fault {draw.index} of {draw.target} would be another one; allowed: as many "
                        "faults in each of the flown missions as before",
                    )

    def row_of(self, spec: RunSpec) -> Row | None:
        """A stored run, as the larger campaign plans it; None = a null run that it flies in another arm.

        Raises:
            BadInputError: The larger campaign has another run in its place.
        """
        # golden runs, or the runs of the same fault
        planned_runs: list[RunSpec] = []
        if spec.fault is None:
            planned_runs = self._extended.golden(*spec.world)
        elif (spec.target, spec.index) in self._draws_of(*spec.world).positions:
            position, draw = self._draws_of(*spec.world).positions[spec.target, spec.index]
            planned_runs = self._extended.injected(spec.environment, draw, position, spec.fault)
        for planned in planned_runs:
            if planned.run_id == spec.run_id:
                return planned.row()
        if spec.target == NULL:
            return None
        raise self.refusal("arms", f"run {spec.run_id} would be another one; {_ALLOWED}")

    def _draws_of(self, environment: str, seed: int) -> _MissionDraws:
        """The draws of a mission in both plans."""
        world = environment, seed
        if world not in self._draws:
            extended = list(self._extended.positioned_draws(*world))
            self._draws[world] = _MissionDraws(
                [draw for _, draw in self._stored.positioned_draws(*world)],
                [draw for _, draw in extended],
                {(draw.target, draw.index): (position, draw) for position, draw in extended},
            )
        return self._draws[world]

    def counts_now(self, spec: RunSpec) -> bool:
        """Whether a golden run has been flown without a fault to draw from it, and has one now.

        Its record will also hold what faults are drawn from.
        """
        draws = self._draws_of(*spec.world)
        before = any(draw.variant == spec.arm for draw in draws.stored)
        now = any(draw.variant == spec.arm for draw in draws.extended)
        return bool(spec.arm) and now and not before

    def adds_nothing_to(self, environment: str, seed: int) -> bool:
        """Whether a mission has no further runs in the larger campaign."""
        draws = self._draws_of(environment, seed)
        same_draws = draws.stored == draws.extended
        arms, arms_now = ([arm.name for arm in plan.campaign.arms] for plan in (self._stored, self._extended))
        return same_draws and arms == arms_now
