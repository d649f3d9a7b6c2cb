"""Templates of `mavfi init` for ROS; see `mavfi.cli.init.GROUP`."""

from pathlib import Path

NODE = Path(__file__).parent / "node"
"""Template of a campaign of faults in the messages of a ROS 2 node."""
