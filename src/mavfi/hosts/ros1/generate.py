"""Generates the Python classes of `mavfi_msgs` with genpy, without catkin (about 50 ms)."""

import importlib
import io
from contextlib import redirect_stderr, redirect_stdout
from functools import cache
from pathlib import Path
from typing import Any

from mavfi.errors import MavfiError
from mavfi.hosts.ros1 import definitions
from mavfi.hosts.ros1.finder import find_file
from mavfi.states import STATES

_PACKAGE = (
    f'<package format="2"><name>{definitions.PACKAGE}</name><version>1.0.0</version><description>Generated.'
    '</description><maintainer email="mavfi@localhost">mavfi</maintainer><license>Apache-2.0</license></package>\n'
)
"""The `package.xml` by which ROS's own tools find the messages."""


def generate(folder: Path) -> None:
    """Write the definitions and classes of `mavfi_msgs` to a folder.

    Raises:
        MavfiError: The generator fails.
    """
    from genpy import generate_initpy
    from genpy.generator import MsgGenerator, SrvGenerator

    package = definitions.PACKAGE
    sources = folder / package
    search = {"std_msgs": [str(find_file("usr/share/std_msgs/msg"))], package: [str(sources / "msg")]}
    for ending, texts, generator in (
        ("msg", definitions.messages(), MsgGenerator()), ("srv", definitions.SERVICES, SrvGenerator())
    ):  # fmt: skip
        target = sources / ending
        target.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            (target / f"{name}.{ending}").write_text(text)
        files = sorted(str(path) for path in target.glob(f"*.{ending}"))
        output = io.StringIO()
        with redirect_stdout(output), redirect_stderr(output):
            failed = generator.generate_messages(package, files, str(target), search)
            generate_initpy.write_modules(str(target))
        if failed:
            raise MavfiError(f"ROS messages: {output.getvalue().strip()}")
        for path in target.glob("_*.py"):
            # genpy generates a method name that NumPy has removed
            path.write_text(path.read_text().replace(".tostring()", ".tobytes()"))
    (sources / "package.xml").write_text(_PACKAGE)
    (sources / "__init__.py").touch()


@cache
def state_types() -> dict[str, Any]:
    """Message class of each state, with list fields as NumPy arrays."""
    from rospy.numpy_msg import numpy_msg

    module = importlib.import_module(f"{definitions.PACKAGE}.msg")
    return {name: numpy_msg(getattr(module, definitions.type_name(spec))) for name, spec in STATES.items()}


@cache
def message_type(name: str) -> Any:
    """Any other message class of `mavfi_msgs`, e.g. "Alarm"."""
    return getattr(importlib.import_module(f"{definitions.PACKAGE}.msg"), name)
