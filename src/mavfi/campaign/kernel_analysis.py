"""Tables of a kernel campaign: what kernels did with faults in their instructions, and what that did to missions."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from mavfi.campaign import paper
from mavfi.campaign.kernel_profiles import read_kernel_profiles
from mavfi.campaign.kernel_rows import DUE, KernelRun, read_kernel_runs
from mavfi.campaign.statistics import Rate, clustered_rate
from mavfi.campaign.store import Store

REMARKS = (
    "SDC rates are quoted; crash, hang and exception rates are those of IR level, not of machine level.",
    "Rates are conditional on one fault per mission; within a kernel faults are uniform over the dynamic instructions "
    "of the mission, then over the bits of the value.",
    "An SDC is any difference in bits of what the kernel published or remembers; its size is in the table of errors.",
    "The paper's Fig. 3 is a drawing without numbers: what its text says of it stands beside.",
)
MEMORY = "(memory only)"
"""State of a silent corruption that nothing published at once."""


def analyse_kernels(store: Store) -> dict[str, Any]:
    """All tables of faults in instructions.

    Args:
        store: The ledger.

    Returns:
        Plain data: `table` (by environment and kernel), `by_value_class` and `by_stratum` (by kernel), `errors` (by
        kernel, state and field that first differed), `instructions` (of golden flights, by kernel), `replayable`
        (runs that give the same bytes again, and all), and `weighted`: whether rates are weighted means, since strata
        were drawn; counts, times and sizes of errors are of flights as they were drawn.
    """
    runs = read_kernel_runs(store)
    return {
        "table": [_entry(own) for own in _groups(runs, lambda run: (run.environment, run.kernel))],
        "by_value_class": [
            {"value_class": own[0].value_class, **_entry(own)}
            for own in _groups(runs, lambda run: (run.kernel, run.value_class))
        ],
        "by_stratum": [
            {"stratum": own[0].stratum, **_entry(own)}
            for own in _groups(runs, lambda run: (run.kernel, run.stratum))
        ],
        "errors": _errors(runs),
        "instructions": {
            kernel: {
                "flights": len(profiles), "calls": sum(p.calls for p in profiles),
                "instructions": sum(p.instructions for p in profiles),
            }
            for kernel, profiles in read_kernel_profiles(store).items()
        },
        "replayable": [sum(run.replayable for run in runs), len(runs)],
        "weighted": any(run.weight != 1.0 for run in runs),
    }  # fmt: skip


def _groups(runs: Iterable[KernelRun], key: Callable[[KernelRun], Any]) -> list[list[KernelRun]]:
    found: dict[Any, list[KernelRun]] = {}
    for run in runs:
        found.setdefault(key(run), []).append(run)
    return list(found.values())


def _entry(own: Sequence[KernelRun]) -> dict[str, Any]:
    """Rates of some runs of one kernel."""
    sdc = [run for run in own if run.outcome == "sdc"]
    inflations = [run.inflation for run in own if run.inflation is not None]
    worst = max(own, key=lambda run: -1.0 if run.inflation is None else run.inflation)
    quantiles = [float(q) for q in np.quantile(inflations, (0.5, 0.95, 1.0))] if inflations else [None] * 3
    golden = {run.world: run.golden_success for run in own}
    return {
        "environment": own[0].environment,
        "kernel": own[0].kernel,
        "n": len(own),
        "counts": dict(Counter(run.outcome for run in own)),
        "masked": _rate(own, lambda run: run.outcome == "masked"),
        "sdc": _rate(own, lambda run: run.outcome == "sdc"),
        "due": _rate(own, lambda run: run.outcome in DUE),
        "flight_changed": _rate(own, lambda run: not run.same_flight),
        "golden": asdict(clustered_rate(list(golden.values()), list(golden))),
        "success_given_sdc": _rate(sdc, lambda run: run.success),
        "success_restart": _rate(own, lambda run: run.success),
        "success_ended": _rate(own, lambda run: run.success_if_ended),
        "time": dict(zip(("median", "p95", "worst"), quantiles, strict=True)),
        "worst_run": worst.run_id if inflations else None,
        "paper": paper.KERNELS.get(own[0].kernel),
    }


def _rate(own: Sequence[KernelRun], test: Callable[[KernelRun], bool]) -> dict[str, Any]:
    rate: Rate = clustered_rate([test(run) for run in own], [run.world for run in own], [run.weight for run in own])
    return asdict(rate)


def _errors(runs: Sequence[KernelRun]) -> list[dict[str, Any]]:
    """Which silent corruptions of a kernel become which errors in what it publishes."""
    table = []
    sdc = [run for run in runs if run.outcome == "sdc"]
    total = Counter(run.kernel for run in sdc)
    for own in _groups(sdc, lambda run: (run.kernel, *_where(run))):
        state, field = _where(own[0])
        sizes = [_number(run.first_difference["largest"]) for run in own if run.first_difference is not None]
        places = [int(run.first_difference["elements"]) for run in own if run.first_difference is not None]
        finite = [size for size in sizes if np.isfinite(size)]
        table.append(
            {
                "kernel": own[0].kernel,
                "state": state,
                "field": field,
                "n": len(own),
                "share": len(own) / total[own[0].kernel],
                "elements": float(np.median(places)) if places else None,
                "size": float(np.median(finite)) if finite else None,
                "largest": max(finite) if finite else None,
                "not_finite": len(sizes) - len(finite),
                "flight_changed": sum(not run.same_flight for run in own),
                "success": _rate(own, lambda run: run.success),
            }
        )
    order = list(total)
    return sorted(table, key=lambda entry: (order.index(str(entry["kernel"])), -int(entry["n"])))


def _where(run: KernelRun) -> tuple[str, str]:
    first = run.first_difference
    return (MEMORY, "") if first is None else (str(first["state"]), str(first["field"]))


def _number(value: float | str) -> float:
    """A size, of which the ledger holds infinities as text."""
    return float(value)
