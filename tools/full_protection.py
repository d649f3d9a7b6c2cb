"""Writes a plan that protects kernels in full: every instruction that can be duplicated, addresses compared.

    python tools/full_protection.py configs/protections/full.yaml pid rrt_connect

The signatures are those of the calls in a golden flight.  No time is measured, hence none is charged: `mavfi harden`
measures it, and chooses sites within a budget.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mavfi.faults.instruction.variant import signature_of
from mavfi.hardening.full import full_plan
from mavfi.hardening.plan import Plan, save_plan
from mavfi.hosts.local import fly
from mavfi.hosts.loop.compose import resolve
from mavfi.mission import MissionSpec
from mavfi.pipeline.functions import PLAIN
from mavfi.states import INJECTABLE, PLANNERS


def called(names: tuple[str, ...], spec: MissionSpec) -> dict[str, list[tuple[Any, ...]]]:
    """Signatures of the calls of each of some functions in a golden flight, in order of their first call."""
    found: dict[str, dict[tuple[Any, ...], None]] = {name: {} for name in names}

    def noting(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any) -> Any:
            found[name][signature_of(args)] = None
            return function(*args)

        return call

    fly(resolve(spec), functions=PLAIN.instrumented(names, noting))
    return {name: list(signatures) for name, signatures in found.items()}


def full(kernels: list[str], environment: str = "sparse", seed: int = 7) -> Plan:
    """The plan for some kernels; functions that the flight does not call are not in it."""
    functions = {name: kernel for kernel in kernels for name in INJECTABLE[kernel]}
    planner = next((kernel for kernel in kernels if kernel in PLANNERS), "rrt_connect")
    signatures = called(tuple(functions), MissionSpec(environment=environment, seed=seed, planner=planner))
    return Plan(
        functions=tuple(
            full_plan(kernel, getattr(PLAIN, name), signature)
            for name, kernel in functions.items()
            for signature in signatures[name]
        )
    )


if __name__ == "__main__":
    save_plan(full(sys.argv[2:]), Path(sys.argv[1]))
