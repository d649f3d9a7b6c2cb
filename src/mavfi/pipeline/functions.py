"""The compiled functions that the kernels call, as a table that a host hands in: any of them can be given a twin.

A twin takes the same arguments and gives the same result, and counts instructions or strikes one of them meanwhile.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from importlib import import_module
from pickle import PicklingError
from typing import Any

from mavfi.kernels.control import pid
from mavfi.kernels.perception import clearance, collision_check, key_sets, octomap, octree, point_cloud
from mavfi.kernels.planning import path, rrt, rrt_connect, rrt_star

Compiled = Callable[..., Any]


@dataclass(frozen=True, slots=True)
class KernelFunctions:
    """Entry points from Python into compiled code; what they call in turn is part of their machine code."""

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

    def with_twins(self, names: tuple[str, ...], twin: Callable[[str, Compiled], Compiled]) -> "KernelFunctions":
        """A table in which some functions have twins.

        Args:
            names: Attributes.
            twin: Gives the twin of a function, from its name and itself.
        """
        return replace(self, **{name: twin(name, getattr(self, name)) for name in names})

    def __reduce__(self) -> tuple[Any, ...]:
        """By name: Numba would send the source, which another process then compiles again, past its cache.

        Raises:
            PicklingError: A function is not what its module calls by its name.
        """
        places = [(function.__module__, function.__qualname__) for function in self._table()]
        if [_imported(*place) for place in places] != self._table():
            raise PicklingError("kernel functions with twins stay in their process")
        return _from_places, (places,)

    def _table(self) -> list[Compiled]:
        return [getattr(self, field.name) for field in fields(self)]


def _imported(module: str, name: str) -> Any:
    return getattr(import_module(module), name, None)


def _from_places(places: list[tuple[str, str]]) -> KernelFunctions:
    return KernelFunctions(*(_imported(*place) for place in places))


PLAIN = KernelFunctions()
"""The functions themselves."""

_SHORTEN = ("shortcut_greedy", "shortcut_random")

STRUCK: dict[str, tuple[str, ...]] = {
    "point_cloud": ("back_project",),
    "octomap": ("insert_scan", "collect", "update_voxels"),
    "collision_check": ("apply_updates", "time_to_collision", "known_free_distance"),
    "rrt": ("plan_rrt", *_SHORTEN),
    "rrt_connect": ("plan_rrt_connect", *_SHORTEN),
    "rrt_star": ("plan_rrt_star", *_SHORTEN),
    "pid": ("track",),
}
"""The seven kernels of the instruction-level study, and the functions that each consists of.

`octomap` calls the first one on a dense map, the two others on an octree.  `collision_check` keeps its own map of room,
and `apply_updates` is the part of it that stores updates there; the planner's copy is not struck.  Of the planners only
the one that the configuration names is flown; finding and shortening paths is struck, the choice among them is not.
"""
