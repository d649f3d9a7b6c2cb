"""What of ROS 2 comes into mavfi's own process, and which installations cannot fly."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from mavfi.errors import BadInputError
from mavfi.extras.ros.lockstep.transport import Middleware
from mavfi.extras.ros.ros2.environment import Installation
from tests.extras.ros.lockstep.needs import each_distribution, find

CODE = """
from pathlib import Path
from mavfi.extras.ros.lockstep.transport import Middleware
Middleware.installed({!r}).load()
import numpy, rclpy, yaml
print(rclpy.__file__, numpy.__file__, yaml.__file__)
import em
"""


@each_distribution
def test_nothing_but_ros_comes_in(ros):
    there = find(ros)
    variables = {**os.environ, **there.variables(Path())}
    done = subprocess.run(
        [sys.executable, "-c", CODE.format(ros)], env=variables, capture_output=True, text=True, check=False
    )
    prefix = str(there.installation.prefix)
    assert [path.startswith(prefix) for path in done.stdout.split()] == [True, False, False]
    assert "No module named 'em'" in done.stderr


def test_an_rclpy_of_another_python_is_refused(tmp_path):
    folder = tmp_path / "lib" / "python3.99" / "site-packages" / "rclpy"
    folder.mkdir(parents=True)
    (folder / "_rclpy_pybind11.cpython-399-x86_64-linux-gnu.so").touch()
    with pytest.raises(BadInputError, match="ROS 2 jazzy: its rclpy is not compiled for this Python"):
        Middleware(Installation("jazzy", "python3", tmp_path, {"AMENT_PREFIX_PATH": str(tmp_path)}), 1).require()
