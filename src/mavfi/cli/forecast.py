"""Forecast of flights, time and disk space for `mavfi campaign run --dry-run`."""

from pathlib import Path
from typing import TYPE_CHECKING

from mavfi.campaign.forecast import forecast
from mavfi.cli.progress import duration

if TYPE_CHECKING:
    from mavfi.campaign.plan import Plan
    from mavfi.campaign.shard import Shard


def forecast_lines(plan: "Plan", ledger: Path, workers: int, shard: "Shard") -> list[str]:
    """Lines about runs, remaining time and size of the ledger, with the source of the estimate."""
    found = forecast(plan, ledger, workers, shard)
    lines = [
        f"{found.golden + found.injected} runs at most, {found.done} of them done in {ledger}",
        f"{found.missions} missions · {found.golden} golden runs, {found.injected} with a fault or null",
    ]
    if found.seconds is None or found.ledger_bytes is None:
        return [*lines, f"time and size of the ledger: not known before runs on host {plan.campaign.host} are in it"]
    source = "measured in this ledger" if found.measured else "assumed from the shipped campaigns, not measured here"
    size = found.ledger_bytes / 1e6
    time_left = f"about {duration(found.seconds)} left with {workers} worker{'s' if workers > 1 else ''}"
    return [*lines, f"{time_left}, ledger about {size:.{0 if size >= 10 else 1}f} MB ({source})"]
