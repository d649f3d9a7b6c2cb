"""Worlds and their generators."""

from mavfi.sim.environments.registry import SCAN_ENDINGS, build_world, environment_for_file, find_generator
from mavfi.sim.environments.world import World

__all__ = ["SCAN_ENDINGS", "World", "build_world", "environment_for_file", "find_generator"]
