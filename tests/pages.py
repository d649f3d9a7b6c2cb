"""Commands of the pages on ROS, as they stand there."""

import os
import shlex
import sys
from pathlib import Path

from mavfi.hosts.ros1 import finder

DOCS = Path(__file__).parents[3] / "docs"
_PROGRAMS = ("make", "mavfi", "rosbag", "$FLIGHT/join")


def commands(page):
    """Indented lines that begin with a program, and lines of a terminal behind its prompt."""
    lines = (DOCS / page).read_text(encoding="utf-8").splitlines()
    found = [line.strip() for line in lines if line.startswith("    ")]
    found += [line[2:] for line in lines if line.startswith("$ ")]
    return [line for line in found if line.split()[0] in _PROGRAMS]


def arguments(command, variables):
    """The command for a new process: `mavfi` is this one, variables are set."""
    for name, value in variables.items():
        command = command.replace(f"${name}", str(value))
    program, *rest = shlex.split(command)
    return [sys.executable, "-m", "mavfi", *rest] if program == "mavfi" else [program, *rest]


def environment():
    """Variables of a shell in which ROS's own tools are found."""
    tools = finder.find_file("usr/bin/roslaunch").parent
    return {**os.environ, **finder.environment(), "PATH": f"{tools}{os.pathsep}{os.environ['PATH']}"}
