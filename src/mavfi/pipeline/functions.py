"""Table of the compiled functions that kernels call, supplied by the host, which can instrument any.

An instrumented function has the same arguments and result, and additionally counts or injects instructions.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pickle import PicklingError
from typing import Any

from mavfi.kernels.control import pid
from mavfi.kernels.perception import clearance, collision_check, key_sets, octomap, octree, point_cloud
from mavfi.kernels.planning import path, rrt, rrt_connect, rrt_star

Compiled = Callable[..., Any]
"""A compiled function."""


@dataclass(frozen=True, slots=True)
class KernelFunctions:
    """Entry points from Python into compiled code; their callees are part of their machine code."""

    back_project: Compiled = point_cloud.back_project
    insert_scan: Compiled = octomap.insert_scan
    collect: Compiled = key_sets.collect
    update_voxels: Compiled = octree.update_voxels
    apply_updates: Compiled = clearance.apply_updates
    time_to_collision: Compiled = collision_check.time_to_collision
    known_free_distance: Compiled = collision_check.known_free_distance
    plan_rrt: Compiled = rrt.plan
    plan_rrt_connect: Compiled = rrt_connect.plan
    plan_rrt_star: Compiled = rrt_star.plan
    shortcut_greedy: Compiled = path.shortcut_greedy
    shortcut_random: Compiled = path.shortcut_random
    track: Compiled = pid.track

    def instrumented(self, names: tuple[str, ...], make: Callable[[str, Compiled], Compiled]) -> "KernelFunctions":
        """A table in which `make(name, function)` replaces each of the named functions."""
        return replace(self, **{name: make(name, getattr(self, name)) for name in names})

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as the plain table: Numba would send the source, which another process would compile again.

        Raises:
            PicklingError: A function is not the plain one.
        """
        if self != PLAIN:
            raise PicklingError("instrumented kernel functions stay in their process")
        return KernelFunctions, ()


PLAIN = KernelFunctions()
"""The uninstrumented functions."""
ENTRIES = tuple(field.name for field in fields(KernelFunctions))
"""Names of these functions."""


@dataclass(frozen=True, slots=True)
class FlightFunctions(KernelFunctions):
    """The table of a flight in which functions of plug-ins, which call them by name, have others called instead.

    Attributes:
        stand_ins: Functions of plug-ins, each with what is called instead.
    """

    stand_ins: tuple[tuple[Compiled, Compiled], ...] = ()
