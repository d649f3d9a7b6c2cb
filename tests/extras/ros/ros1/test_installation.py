"""Of Debian's Python packages, nothing but ROS comes in."""

import subprocess
import sys

from tests.extras.ros.ros1.needs import ros
from tools import install_ros as install

pytestmark = ros


def python(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


def test_ros_comes_from_debian_and_numpy_from_here():
    code = (
        "import warnings; warnings.simplefilter('ignore')\n"
        "from mavfi.extras.ros.ros1 import finder; finder.enable()\n"
        "import numpy, rospy, yaml\nprint(rospy.__file__, numpy.__file__, yaml.__file__)"
    )
    rospy, numpy, yaml = python(code).stdout.split()
    assert "dist-packages" in rospy
    assert "dist-packages" not in numpy and "dist-packages" not in yaml


def test_nothing_else_of_debian_comes_in():
    code = "from mavfi.extras.ros.ros1 import finder; finder.enable(); import apt_pkg"
    assert "ModuleNotFoundError" in python(code).stderr


def test_an_installation_that_is_there_is_left_as_it_is(capsys):
    assert install.main() == 0
    text = capsys.readouterr().out
    assert text.startswith("ROS 1 1.") and all("here" in line for line in text.splitlines())
