"""Templates of `mavfi init` for ROS; see `mavfi.cli.init.GROUP`."""

from pathlib import Path

NODE = Path(__file__).parent / "node"
"""A ROS 2 node of one's own under test."""
