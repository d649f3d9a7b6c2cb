"""Worlds and their generators."""

from mavfi.sim.environments.registry import build_world, environment_for_file, find_generator, scenario_world
from mavfi.sim.environments.world import World

__all__ = ["World", "build_world", "environment_for_file", "find_generator", "scenario_world"]
