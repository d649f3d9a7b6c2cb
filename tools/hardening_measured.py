"""Rows of docs/generated/hardening.md for whole commands: time of the advice and of builds, all faults.

Each of these measures a few minutes of work; `tools.build_hardening` keeps the results by the digest of the source.
"""

import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

from mavfi.campaign.hardening.certify import Pair, pairs_of
from mavfi.campaign.hardening.observed import observe
from mavfi.campaign.hardening.study import Study
from mavfi.faults.instruction.build import build, cached_build
from mavfi.hardening.plan import Plan
from mavfi.hardening.protection import Protection

ADVICE_S, BUILD_S = 60.0, 1.0
"""Allowed time of `mavfi harden`, and of the protected code of a kernel from the cache (s)."""
EXHAUSTIVE = ("mean_square", "walk")
"""Kernels of tests/unit/hardening/kernels.py that are injected exhaustively."""
Row = dict[str, Any]


def measure(study: Study, plan: Plan) -> Row:
    """What `rows` needs, as plain data."""
    planner, kernels = next(iter(study.by_planner().items()))
    seen = observe(study.fresh(planner)[0], kernels)
    pairs = pairs_of([one for own in seen.values() for one in own], plan)  # builds what is not in the cache
    return {
        "advice_s": advice_s(study.directory), "build_s": build_s(pairs, cached_build), "anew_s": build_s(pairs, build),
        "exhaustive": {name: exhaustive(name, addresses=True) for name in EXHAUSTIVE},
        "without_addresses": {name: exhaustive(name, addresses=False) for name in EXHAUSTIVE},
    }  # fmt: skip


def advice_s(directory: Path) -> float:
    """Wall time of `mavfi harden` on a ledger (s)."""
    with TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "mavfi", "harden", str(directory), "--plan", f"{folder}/plan.yaml"]
        start = perf_counter()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        return perf_counter() - start


def build_s(pairs: list[Pair], built: Callable[..., Any]) -> dict[str, float]:
    """Time in which the protected code of each kernel is built, or read from the cache (s)."""
    found: dict[str, float] = defaultdict(float)
    for pair in pairs:
        start = perf_counter()
        built(pair.seen.function, pair.seen.signature, Protection(pair.planned))
        found[pair.planned.kernel] += perf_counter() - start
    return dict(found)


def exhaustive(name: str, *, addresses: bool) -> dict[str, int]:
    """Outcomes of every bit of every dynamic instruction of a small kernel in full duplication, by number."""
    kernels: Any = import_module("tests.unit.hardening.kernels")
    strikes: Any = import_module("tests.unit.hardening.strikes")
    kernel, args = kernels.CASES[name]
    found, _ = strikes.strike_all(strikes.variant(kernel, args, strikes.Full(addresses=addresses)), args)
    return dict(found)


def rows(measured: Row) -> list[list[str]]:
    """Rows of the table of requirements."""
    slowest = max(measured["build_s"], key=measured["build_s"].get)
    longest = max(measured["anew_s"], key=measured["anew_s"].get)
    plain, compared = (_outcomes(measured[key]) for key in ("without_addresses", "exhaustive"))
    kernels = " and ".join(measured["exhaustive"])
    return [
        _row("`mavfi harden`", f"≤ {ADVICE_S:g} s on two cores", f"{measured['advice_s']:.0f} s",
             measured["advice_s"] <= ADVICE_S),
        _row("protected code of a kernel, from the cache", f"≤ {BUILD_S:g} s",
             f"{measured['build_s'][slowest]:.2f} s ({slowest}, the slowest)", measured["build_s"][slowest] <= BUILD_S),
        ["the same, from the IR of the kernel: once per machine", "—",
         f"{measured['anew_s'][longest]:.1f} s ({longest}, the slowest)", "", ""],
        _row(f"every bit of every dynamic instruction of {kernels}", "0 SDC", _told(plain), not plain["sdc"]),
        _row("the same, addresses compared", "0 SDC, 0 crash, 0 hang", _told(compared),
             not any(compared[how] for how in ("sdc", "crash", "hang", "exception"))),
    ]  # fmt: skip


def _outcomes(found: dict[str, dict[str, int]]) -> Counter[str]:
    """Numbers of outcomes over all kernels."""
    return sum((Counter(own) for own in found.values()), Counter())


def _told(outcomes: Counter[str]) -> str:
    return ", ".join(f"{count:,} {how}" for how, count in sorted(outcomes.items()))


def _row(what: str, required: str, found: str, met: bool) -> list[str]:
    return [what, required, found, "yes" if met else "no", ""]
