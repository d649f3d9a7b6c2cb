"""Plug-ins of missions by their names, without importing them: what faults and tables call them.

A plug-in stands in faults and tables under the name that the mission gives it, without the module: `AStar` for
`my_planner:AStar`.  A request may also use the whole name, or the key of the mission (`planner`, `map`,
`flight_controller`, `detector`).
"""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass

from mavfi.config import PlannerConfig, shipped
from mavfi.errors import BadInputError
from mavfi.mission import MissionSpec
from mavfi.plugins import known
from mavfi.states import DETECTORS, INJECTABLE, KERNELS, PLANNERS, PLUG_INS, REPLACEABLE

_SHIPPED: Mapping[str, Collection[str]] = {
    "map": ("dense", "octree"),
    "planner": tuple(PLANNERS),
    **dict.fromkeys(REPLACEABLE, ("",)),
    "flight_controller": ("cascade",),
    "detector": ("",),
}
"""What is part of mavfi, by role; a detector is given only if it is not."""


@dataclass(frozen=True, slots=True)
class PlugIn:
    """A plug-in of a mission.

    Attributes:
        role: As in `states.PLUG_INS`.
        address: As the mission names it: "package.module:Class", or an entry point.
        name: Its name in faults and tables.
    """

    role: str
    address: str
    name: str

    def is_called(self, text: str) -> bool:
        """Whether a request for a fault means it."""
        return text in (self.name, self.address, short_name(self.address), self.role, PLUG_INS[self.role].kernel)


def short_name(address: str) -> str:
    """A name without the module: `AStar` for `my_planner:AStar`."""
    return address.rpartition(":")[2]


def without_module(text: str, operations: Collection[str] = ()) -> str:
    """A request for a fault without the module of the plug-in that it begins with, if it does.

    What follows the first colon is then no option, and none of these `operations`.
    """
    match = re.match(r"[A-Za-z_][\w.]*:([A-Za-z_]\w*)(?=[:@.]|$)", text)
    if match is None or match[1] in operations:
        return text
    return text[match.start(1) :]


def planner_name(planner: str) -> str:
    """The path search of a mission's planner, which may be the YAML file of its parameters."""
    if not planner.endswith((".yaml", ".yml")):
        return planner
    try:
        return shipped("planners", PlannerConfig, planner).name
    except BadInputError:  # a ledger is read elsewhere
        return planner


def plug_ins(addresses: Mapping[str, str]) -> list[PlugIn]:
    """The plug-ins among the parts of a mission, which are given by role (`PLUG_INS`) in the order of the data flow."""
    addresses = {role: address for role, address in addresses.items() if address not in _SHIPPED[role]}
    # One that has the name of another target is called by its role instead.
    names = [*INJECTABLE, *DETECTORS, *KERNELS, *map(short_name, addresses.values())]
    members = []
    for role, address in addresses.items():
        name = short_name(address)
        if names.count(name) > 1:
            name = role
        members.append(PlugIn(role, address, name))
    return members


def plug_ins_of_spec(spec: MissionSpec, detector: str = "") -> list[PlugIn]:
    """The plug-ins of a mission, with a detector that is none of mavfi ("" = none)."""
    of_kernels = {name: getattr(spec, name) for name in REPLACEABLE}
    return plug_ins(
        {
            "map": spec.map,
            "planner": planner_name(spec.planner),
            **of_kernels,
            "flight_controller": spec.flight_controller,
            "detector": detector,
        }
    )


def is_custom_detector(name: str) -> bool:
    """Whether a name is that of a detector which is not part of mavfi; "" is none."""
    return bool(name) and not known("mavfi.detectors", {}).get(name, name).startswith("mavfi.")
