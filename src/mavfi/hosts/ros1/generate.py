"""Generates the Python classes of `mavfi_msgs` and `nav_msgs` with genpy, without catkin (about 50 ms)."""

import importlib
import io
from contextlib import redirect_stderr, redirect_stdout
from functools import cache
from pathlib import Path
from typing import Any

from mavfi.errors import MavfiError
from mavfi.hosts.ros1 import definitions, finder
from mavfi.hosts.ros1.finder import find_file
from mavfi.states import STATES

_SEARCHED = ("std_msgs", "geometry_msgs", "actionlib_msgs")


def generate(folder: Path) -> None:
    """Write definitions and classes of `mavfi_msgs` and `nav_msgs`, one folder per package.

    Raises:
        MavfiError: The generator fails.
    """
    sources = folder / definitions.PACKAGE
    for ending, texts in (("msg", definitions.messages()), ("srv", definitions.SERVICES)):
        (sources / ending).mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            (sources / ending / f"{name}.{ending}").write_text(text)
    (sources / "package.xml").write_text(package_xml(definitions.PACKAGE))
    search = {package: [str(find_file(f"usr/share/{package}/msg"))] for package in (*_SEARCHED, "nav_msgs")}
    search[definitions.PACKAGE] = [str(sources / "msg")]
    _generate(definitions.PACKAGE, sources, sources, search)
    _generate("nav_msgs", find_file("usr/share/nav_msgs"), folder / "nav_msgs", search)


def name_definitions(folder: Path) -> None:
    """Link Debian's message packages, adding to each the `package.xml` that rosmsg requires and Debian omits."""
    for root in reversed(finder.roots()):
        for place in sorted((root / "usr/share").glob("*/msg")):
            if not (place.parent / "package.xml").exists():
                package = folder / place.parent.name
                package.mkdir(parents=True, exist_ok=True)
                (package / "package.xml").write_text(package_xml(package.name))
                for kind in ("msg", "srv"):
                    (package / kind).unlink(missing_ok=True)
                    (package / kind).symlink_to(place.parent / kind)


def package_xml(name: str) -> str:
    """The `package.xml` of a generated package."""
    return (
        f'<package format="2"><name>{name}</name><version>1.0.0</version><description>Generated.</description>'
        '<maintainer email="mavfi@localhost">mavfi</maintainer><license>Apache-2.0</license></package>\n'
    )


def _generate(package: str, sources: Path, folder: Path, search: dict[str, list[str]]) -> None:
    from genpy import generate_initpy
    from genpy.generator import MsgGenerator, SrvGenerator

    for ending, generator in (("msg", MsgGenerator()), ("srv", SrvGenerator())):
        files = sorted(str(path) for path in (sources / ending).glob(f"*.{ending}"))
        target = folder / ending
        target.mkdir(parents=True, exist_ok=True)
        output = io.StringIO()
        with redirect_stdout(output), redirect_stderr(output):
            failed = generator.generate_messages(package, files, str(target), search)
            generate_initpy.write_modules(str(target))
        if failed:
            raise MavfiError(f"ROS messages: {package}: {output.getvalue().strip()}")
        for path in target.glob("_*.py"):
            # genpy generates a method name that NumPy has removed
            path.write_text(path.read_text().replace(".tostring()", ".tobytes()"))
    (folder / "__init__.py").touch()


@cache
def state_types() -> dict[str, Any]:
    """Message class of each state, with list fields as NumPy arrays."""
    from rospy.numpy_msg import numpy_msg

    module = importlib.import_module(f"{definitions.PACKAGE}.msg")
    return {name: numpy_msg(getattr(module, definitions.type_name(spec))) for name, spec in STATES.items()}


@cache
def message_type(name: str) -> Any:
    """Any other message class of `mavfi_msgs`, e.g. "Verdict"."""
    return getattr(importlib.import_module(f"{definitions.PACKAGE}.msg"), name)
