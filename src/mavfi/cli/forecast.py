"""Forecast of flights, time and disk space for `mavfi campaign run --dry-run`."""

from pathlib import Path
from typing import TYPE_CHECKING

from mavfi.campaign.forecast import forecast
from mavfi.cli.console import counted
from mavfi.cli.progress import duration

if TYPE_CHECKING:
    from mavfi.campaign.plan import Plan
    from mavfi.campaign.shard import Shard


def forecast_lines(plan: "Plan", ledger: Path, workers: int, shard: "Shard") -> list[str]:
    """Lines about runs, remaining time and size of the ledger, with the source of the estimate."""
    found = forecast(plan, ledger, workers, shard)
    lines = [
        f"{counted(found.golden + found.injected, 'run')} at most, {found.done} of them done in {ledger}",
        f"{counted(found.missions, 'mission')} · {counted(found.golden, 'golden run')}, "
        f"{found.injected} with a fault or null",
    ]
    if found.seconds is None or found.ledger_bytes is None:
        host = plan.campaign.host
        return [*lines, f"time and size of the ledger: no estimate until the ledger holds runs on host {host}"]
    source = "measured in this ledger" if found.measured else "assumed from the shipped campaigns, not measured here"
    size = found.ledger_bytes / 1e6
    time_left = f"about {duration(found.seconds)} left with {counted(workers, 'worker')}"
    return [*lines, f"{time_left}, ledger about {size:.{0 if size >= 10 else 1}f} MB ({source})"]
