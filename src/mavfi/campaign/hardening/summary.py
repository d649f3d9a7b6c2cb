"""An advice as plain data, for the terminal, JSON and the page."""

from collections import defaultdict
from collections.abc import Collection, Sequence
from dataclasses import asdict
from typing import Any

from mavfi.campaign.analysis.statistics import Rate
from mavfi.campaign.hardening.advise import Advice, Curve, Step, coverage_of, coverage_of_steps
from mavfi.campaign.hardening.ledger import Harm
from mavfi.campaign.hardening.study import Study
from mavfi.campaign.hardening.target import Target
from mavfi.campaign.hardening.ways import Compared
from mavfi.hardening.candidates import candidates
from mavfi.hardening.flow import added
from mavfi.hardening.plan import Coverage, Plan, Site


def summary(study: Study, advices: Sequence[Advice], harm: Harm, plan: Plan | None = None) -> dict[str, Any]:
    """The advice: what to protect, what it costs, which share of the silent corruptions goes, and what remains.

    The certified coverage of functions is that of the plan.

    `coverage` and `spent` are of the campaign's own missions; other planners fly in their own.
    """
    first = advices[0]
    planned = () if plan is None else plan.functions
    certified = {(one.function, one.signature): one.certified for one in planned if one.certified is not None}
    pairs = [pair for advice in advices for pair in advice.steps if pair[0].target.injections]
    return {
        "campaign": study.campaign.name, "ledger": study.digest, "budget": first.budget, "spent": first.spent,
        "coverage": asdict(first.coverage), "injections": sum(len(curve.target.injections) for curve, _ in pairs),
        "complete": study.complete, "selected": list(study.selected),
        "addresses": any(curve.target.addresses for curve, _ in pairs),
        "kernels": [_kernel(kernel, pairs) for kernel in study.kernels],
        "functions": [
            _function(curve, step) | {"certified": _rate(certified.get(curve.target.key))} for curve, step in pairs
        ],
        "harm": asdict(harm),
    }  # fmt: skip


def _rate(found: Coverage | None) -> dict[str, float] | None:
    return None if found is None else {"rate": found.estimate, "low": found.low, "high": found.high}


def _kernel(kernel: str, pairs: Sequence[tuple[Curve, Step]]) -> dict[str, Any]:
    own = [(curve, step) for curve, step in pairs if kernel in curve.target.kernels]
    share = sum(curve.share for curve, _ in own)
    added = sum(curve.extra(step) for curve, step in own)
    return {
        "kernel": kernel, "share": share, "added": added, "time": 1 + added / share if share else 1.0,
        "coverage": asdict(coverage_of_steps(own)),
    }  # fmt: skip


def _function(curve: Curve, step: Step) -> dict[str, Any]:
    target = curve.target
    sites = target.sites(step.choice)
    return {
        "kernel": target.kernels[0], "function": target.name, "entry": target.seen.entry,
        "signature": target.seen.signature_text, "calls": target.seen.total, "instructions": target.seen.instructions,
        "injections": len(target.injections), "sdc": asdict(_sdc(target)), "share": curve.share,
        "time": step.time, "added": curve.extra(step), "coverage": asdict(step.coverage), "sites": len(sites),
        "all_sites": len(target.values), "steps": [_step(curve, one, one is step) for one in curve.steps],
        "ways": [_ways(one) for one in curve.compared],
        "escapes": _escapes(target, sites), "lines": _lines(target, sites),
    }  # fmt: skip


def _sdc(target: Target) -> Rate:
    """Silent corruptions per injection in recorded calls."""
    return coverage_of([(one, one.sdc) for one in target.injections])


def _step(curve: Curve, step: Step, chosen: bool) -> dict[str, Any]:
    return {
        "fraction": step.fraction, "instructions": growth_of(curve, step),
        "time": step.time, "coverage": asdict(step.coverage), "chosen": chosen,
    }  # fmt: skip


def growth_of(curve: Curve, step: Step) -> float:
    """Dynamic instructions of a step / those of the plain function."""
    return 1 + added(curve.target.values, step.choice.chosen) / max(curve.target.seen.instructions, 1)


def _ways(compared: Compared) -> dict[str, Any]:
    """Coverage of each way to choose at one cost, and p of McNemar's test of the minimum cut against the others."""
    return {
        "share": compared.share, "p": {way: test.p_value for way, test in compared.tests.items()},
        "coverage": {way: asdict(coverage_of(judged)) for way, judged in compared.judged.items()},
    }  # fmt: skip


def _escapes(target: Target, sites: Collection[Site]) -> dict[str, float]:
    """Shares of the expected silent corruptions: removed, not affordable, and not duplicable, the latter by opcode."""
    able = set(candidates(target.module))
    found: dict[str, float] = defaultdict(float)
    for site, row, _, mass in target.masses:
        kept = "protected" if site in sites else "beyond the budget" if site in able else f"cannot repeat: {row.opcode}"
        found[kept] += mass
    whole = max(sum(found.values()), 1e-300)
    return {name: mass / whole for name, mass in sorted(found.items(), key=lambda item: -item[1]) if mass}


def _lines(target: Target, sites: Collection[Site]) -> list[dict[str, Any]]:
    """Executed source lines: shares of instructions and silent corruptions, and how much of the latter is protected."""
    found: dict[tuple[str, int], list[float]] = defaultdict(lambda: [0.0, 0.0, 0.0])
    for site, row, times, mass in target.masses:
        own = found[row.file, row.line]
        own[0] += times
        own[1] += mass
        own[2] += mass if site in sites else 0.0
    instructions, corruptions = (max(sum(own[place] for own in found.values()), 1e-300) for place in (0, 1))
    return [
        {
            "file": file, "line": line, "instructions": times / instructions, "sdc": mass / corruptions,
            "protected": kept / mass if mass else 0.0,
        }
        for (file, line), (times, mass, kept) in sorted(found.items())
    ]  # fmt: skip
