"""Writes a plan that protects kernels in full: every instruction that can be duplicated, addresses compared.

    python tools/full_protection.py configs/protections/full.yaml pid rrt_connect

Signatures and calls, in which the time is measured, are those of a golden flight.
"""

import sys
from pathlib import Path
from typing import Any

from mavfi.campaign.fingerprint import processor
from mavfi.extras.hardening.advise import codes_of, times_of
from mavfi.extras.hardening.duplicate import candidates
from mavfi.extras.hardening.observed import observe
from mavfi.extras.hardening.plan import FunctionPlan, ProtectionPlan, save_plan, signature_text
from mavfi.extras.hardening.target import targets_of
from mavfi.flight.compose import resolve
from mavfi.ir.module import digest_of
from mavfi.ir.parser import parse_module
from mavfi.ir.sources import cached_source
from mavfi.mission import MissionSpec
from mavfi.states import PLANNERS


def full_plan(kernel: str, function: Any, signature: tuple[Any, ...]) -> FunctionPlan:
    """Plan that duplicates all of a compiled function for a signature.

    Args:
        kernel: Kernel of the pipeline that calls it.
        function: The compiled function.
        signature: Numba types of its arguments.

    Raises:
        NotInstrumentableError: The function has an unknown construct.
        BuildError: The compiler crashed.
    """
    source = cached_source(function, signature)
    module = parse_module(source.text, source.kernel)
    return FunctionPlan(
        kernel=kernel,
        function=source.kernel,
        signature=signature_text(signature),
        ir_sha256=digest_of(module),
        addresses=True,
        sites=tuple(candidates(module)),
    )


def full(kernels: list[str], environment: str = "sparse", seed: int = 7) -> ProtectionPlan:
    """The plan for some kernels; functions that the flight does not call are not in it."""
    planner = next((kernel for kernel in kernels if kernel in PLANNERS), "rrt_connect")
    seen = observe(resolve(MissionSpec(environment=environment, seed=seed, planner=planner)), kernels)
    functions: list[FunctionPlan] = []
    for target in targets_of(seen, addresses=True):
        planned = full_plan(target.kernels[0], target.seen.function, target.seen.signature)
        _, (time,) = times_of(target, codes_of(target, [planned.sites]))
        functions.append(planned.model_copy(update={"time": round(time, 3)}))
    return ProtectionPlan(cpu=processor(), functions=tuple(functions))


if __name__ == "__main__":
    save_plan(full(sys.argv[2:]), Path(sys.argv[1]))
