"""Chooses the run of a campaign that tells most, and draws it: golden, with the fault, and with a detector on."""

from pathlib import Path

from mavfi.campaign.flights import Row, is_injected, read_rows
from mavfi.campaign.plan import FI, GOLDEN, RunSpec
from mavfi.campaign.store import Store
from mavfi.reports.picture import draw_flight
from mavfi.reports.text import signed_percent
from mavfi.reports.watch import fly_watched

_INTERESTING = 0.02
"""Flight time over the golden twin's from which a run that succeeds is worth a picture."""


def draw_telling_run(directory: Path, path: Path) -> str | None:
    """Fly a telling run again and draw it.

    A run that fails and that a detector brings home tells most; then one that fails; then the slowest.

    Args:
        directory: Where the ledger is.
        path: File to write.

    Returns:
        What the picture shows; None if no run is worth one, and then nothing is written.

    Raises:
        BadInputError: The file cannot be written.
    """
    with Store.open(directory) as store:
        rows = [row for row in read_rows(store) if is_injected(row) and row.judged and row.site_fate == "hit"]
        chosen = choose(rows)
        if chosen is None:
            return None
        struck, healed = chosen
        flight = fly_watched(store, struck.spec).flight
        golden = fly_watched(store, golden_spec(store, struck.spec)).flight
        recovered = None if healed is None else fly_watched(store, healed.spec).flight
        draw_flight(path, flight, golden, recovered)
    return _caption(struck, healed)


def choose(rows: list[Row]) -> tuple[Row, Row | None] | None:
    """The run with a fault that tells most, and the same with a detector on where that one brings it home.

    Args:
        rows: Runs whose fault hit.
    """
    faulty = [row for row in rows if row.spec.setting == FI and row.golden is not None and row.golden.get("success")]
    arms = {(row.pair, row.spec.arm): row for row in rows if row.spec.arm and row.success}
    failed = [row for row in faulty if not row.success]
    for row in sorted(failed, key=_latest):
        for (pair, _), healed in arms.items():
            if pair == row.pair:
                return row, healed
    if failed:
        return min(failed, key=_latest), None
    slowest = max(faulty, key=lambda row: row.inflation or 0.0, default=None)
    if slowest is None or (slowest.inflation or 0.0) < _INTERESTING:
        return None
    faster = [row for (pair, _), row in arms.items() if pair == slowest.pair and (row.inflation or 0.0) < _INTERESTING]
    return slowest, faster[0] if faster else None


def _latest(row: Row) -> float:
    """Long flights first: there is most to see."""
    return -float(row.record.get("distance_m", 0.0))


def golden_spec(store: Store, spec: RunSpec) -> RunSpec:
    """The golden run of the same mission, without a detector."""
    wanted = (GOLDEN if spec.detector else spec.golden_setting, spec.environment, spec.seed)
    runs = (run.spec for run in store.runs(phase=1))
    return next(s for s in runs if (s.setting, s.environment, s.seed) == wanted)


def _caption(struck: Row, healed: Row | None) -> str:
    injection = struck.record["injections"][0]
    told = f"`{struck.spec.run_id}`: {injection['site']}, bit {injection['bit']}, at {injection['time_s']:.2f} s"
    change = "" if struck.inflation is None else f" ({signed_percent(struck.inflation)} flight time)"
    told += f"; ends in {struck.status.replace('_', ' ')}{change}."
    if healed is not None:
        told += f" With {healed.spec.arm} on it reaches the goal."
    return f"{told} See `mavfi explain`."
