"""Writes a plan that protects kernels in full: every instruction that can be duplicated, addresses compared.

    python tools/full_protection.py configs/protections/full.yaml pid rrt_connect

Signatures and calls, in which the time is measured, are those of a golden flight.
"""

import sys
from pathlib import Path

from mavfi.campaign.fingerprint import processor
from mavfi.extras.hardening.advise import codes_of, times_of
from mavfi.extras.hardening.observed import observe
from mavfi.extras.hardening.plan import FunctionPlan, ProtectionPlan, save_plan
from mavfi.extras.hardening.target import targets_of
from mavfi.flight.compose import resolve
from mavfi.mission import MissionSpec
from mavfi.states import PLANNERS
from tools.full_plan import full_plan


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
