"""The in-process host and the detectors as the tools of a campaign.

They are imported when they are first wanted: reading a ledger needs no simulator.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from mavfi.campaign.config import KernelFaults
from mavfi.campaign.worker import DrawnFaults, Family, Flight, Tools
from mavfi.detectors.detector import Detector
from mavfi.faults.fault import Fault
from mavfi.mission import Scenario

if TYPE_CHECKING:
    from mavfi.hosts.inprocess import Flight as HostFlight

_DRAWN_KEPT = 8
_drawn: "dict[str, HostFlight]" = {}
"""Golden flights for which this process has drawn, by mission: those with the faults are most often flown next."""


def host_tools() -> Tools:
    """The tools that campaigns fly with."""
    return Tools(_fly, _load_detector, _make_scenario, _make_family, _draw, _strike)


def _fly(scenario: Scenario, fault: Fault | None, detector: Detector | None, *, want_profile: bool) -> Flight:
    if fault is not None and fault.level == "instruction":
        from mavfi.hosts.instruction import fly_struck

        return fly_struck(scenario, [fault], detector).flights[0]
    from mavfi.hosts.inprocess import fly

    return fly(scenario, fault, detector, want_profile=want_profile)


def _draw(
    scenario: Scenario, draws: Mapping[str, int], kernels: KernelFaults, environment: str, seed: int
) -> DrawnFaults:
    from mavfi.hosts.kernel_faults import Wish, draw_kernel_faults

    wish = Wish(draws, kernels.which, kernels.model, kernels.restart_s, sampling=kernels.sampling)
    drawn = draw_kernel_faults(scenario, wish, environment, seed=seed)
    while len(_drawn) >= _DRAWN_KEPT:
        del _drawn[next(iter(_drawn))]
    _drawn[_key(scenario)] = drawn.golden
    return drawn


def _key(scenario: Scenario) -> str:
    return json.dumps(scenario.to_json(), sort_keys=True)


def _strike(scenario: Scenario, faults: Sequence[Fault], detector: Detector | None) -> Sequence[Flight]:
    from mavfi.hosts.instruction import fly_struck

    golden = None if detector is not None else _drawn.get(_key(scenario))
    return fly_struck(scenario, faults, detector, golden).flights


def _make_family(scenario: Scenario) -> Family:
    from mavfi.hosts.forking import Family

    return Family(scenario)


def _load_detector(detector: str, profile: str, models_dir: Path | None, scenario: Scenario) -> tuple[Detector, str]:
    from mavfi.detectors.registry import load_detector
    from mavfi.sim.environments import build_world

    world = build_world(scenario.environment, scenario.seed, scenario.start, scenario.goal)
    fits = {
        "stack": scenario.stack.name,
        "platform": scenario.platform.name,
        "v_max": scenario.v_max,
        "planner": scenario.planner.name,
        "arena": (world.arena_lower.tolist(), world.arena_upper.tolist()),
    }
    return load_detector(detector, profile, models_dir, fits)


def _make_scenario(
    environment: str,
    seed: int,
    *,
    stack: str,
    platform: str,
    planner: str,
    v_max: float | None,
    map_kind: str = "dense",
    vehicle: str | None = None,
) -> Scenario:
    from mavfi.hosts.compose import make_scenario

    return make_scenario(
        environment, seed, stack=stack, platform=platform, planner=planner, v_max=v_max, map_kind=map_kind,
        vehicle=vehicle,
    )  # fmt: skip
