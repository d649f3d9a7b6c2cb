"""Compilation of a mission's kernels, stage by stage.

A flight compiles one function after the other, as it needs them.  Its stages need each other's results, but not each
other's code: processes that compile one stage each are done sooner, and every process then finds the code in the cache.
"""

from collections.abc import Callable

import numpy as np

from mavfi.flight.compose import new_loop
from mavfi.flight.loop import Loop
from mavfi.mission import Scenario
from mavfi.rewriting import check_flown
from mavfi.states import new_state, rows

_LATER_US = 1_000_000
"""Simulated time within which the results of a stage have reached their readers (us)."""


def follow_path(loop: Loop) -> None:
    """Compile what follows from a path with a corner: the trajectory, its check, and tracking."""
    corners = np.linspace(loop.world.start, loop.world.goal, 3)
    corners[1, :2] += 1.0
    path = new_state("planning.path", len(corners))
    rows(path.elements, 3)[:] = corners
    loop.sense(0)
    loop.publish(path, 0)
    _run(loop)


def plan_path(loop: Loop) -> None:
    """Compile the planner: a plan on an empty map."""
    loop.sense(0)
    loop.publish(new_state("perception.map_update"), 0)
    loop.start(loop.kernels["planner"], 0)


def see(loop: Loop) -> None:
    """Compile camera, perception and vehicle: what follows from a depth image."""
    loop.publish(loop.sensors.depth(), 0)
    _run(loop)


def _run(loop: Loop) -> None:
    """Run until what was published has reached its readers."""
    loop.at(_LATER_US, "tick")
    loop.run(until=0)


STAGES: dict[str, Callable[[Loop], None]] = {"follow_path": follow_path, "plan_path": plan_path, "see": see}
"""Parts of a flight by name, the one that takes longest first."""


def compile_stage(stage: str, scenario: Scenario) -> None:
    """Compile one of `STAGES`.

    Raises:
        BadInputError: The scenario cannot be flown, or its protection is for other code.
    """
    with np.errstate(all="ignore"):
        STAGES[stage](new_loop(scenario))
    check_flown(scenario.protection)
