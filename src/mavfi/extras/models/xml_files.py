"""XML files of models: reading, numbers in them, and files that they name."""

import math
import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

from mavfi.errors import BadInputError
from mavfi.files import LARGEST_TEXT, is_dir, is_file, read_file

PATH_VARIABLES = (
    "GZ_SIM_RESOURCE_PATH",
    "IGN_GAZEBO_RESOURCE_PATH",
    "SDF_PATH",
    "GAZEBO_MODEL_PATH",
    "GAZEBO_RESOURCE_PATH",
    "ROS_PACKAGE_PATH",
    "AMENT_PREFIX_PATH",
)
"""Environment variables with folders of models, as Gazebo and ROS use them."""
_FOLDERS = ("", "models", "share")
"""Where models are inside a folder that is searched."""
_PREFIX = re.compile(rb"""(</?|\s)([A-Za-z_][\w.-]*):(?=[\w.-]+(?:\s*=\s*["']|[\s/>]))""")
"""Prefixes of elements and attributes."""
_BEFORE_DECLARATION = re.compile(rb"\A(?:\xef\xbb\xbf|\s|<!--.*?-->)+(?=<\?xml\s)", re.DOTALL)
"""A byte-order mark of UTF-8, blank lines and comments that come before the declaration."""
_NEAR = 4
"""Number of folders above a file that are searched as well."""


def parse_xml(text: bytes | str, path: Path) -> ET.Element:
    """Root of an XML document; `path` is for messages.

    Raises:
        BadInputError: It is no XML.
    """
    if isinstance(text, str):
        data = text.encode()
    else:
        data = text
    # Gazebo's parser accepts blank lines and comments before the declaration, and prefixes that are not declared
    data = _BEFORE_DECLARATION.sub(b"", data).lstrip()
    try:
        try:
            return ET.fromstring(data)  # noqa: S314 - expat limits the expansion of entities
        except ET.ParseError as error:
            if "unbound prefix" not in str(error):
                raise
            return ET.fromstring(_PREFIX.sub(rb"\1\2.", data))  # noqa: S314
    except (ET.ParseError, LookupError, ValueError) as error:  # LookupError: of its encoding
        raise BadInputError(f"{path}: not an XML file ({error})") from None


def read_xml(path: Path) -> ET.Element:
    """Root of an XML file; raises a `BadInputError` if it cannot be read, or is no XML."""
    if not is_file(path):
        raise BadInputError(f"{path}: there is no such file")
    return parse_xml(read_file(path, LARGEST_TEXT), path)


def numbers(text: str | None, count: int, what: str) -> tuple[float, ...]:
    """Numbers in a text, separated by spaces.

    Raises:
        BadInputError: They are not `count` finite numbers.
    """
    try:
        values = tuple(float(word) for word in (text or "").split())
    except ValueError:
        values = ()
    if len(values) != count or not all(map(math.isfinite, values)):
        raise BadInputError(f"{what}: {(text or '').strip()!r}: allowed: {count} finite numbers")
    return values


def number(element: ET.Element | None, what: str) -> float | None:
    """The number in an element; None = there is no such element."""
    if element is None or not (element.text or "").strip():
        return None
    return numbers(element.text, 1, what)[0]


def search_folders(path: Path) -> Iterator[Path]:
    """Folders in which what a file names is looked for: those above it, and those of Gazebo's and ROS's variables."""
    above = path.absolute().parent
    for folder in [above, *above.parents[:_NEAR]]:
        for inner in _FOLDERS:
            yield folder / inner
    for variable in PATH_VARIABLES:
        for entry in filter(None, os.environ.get(variable, "").split(os.pathsep)):
            for inner in _FOLDERS:
                yield Path(entry) / inner


def find_file(uri: str, path: Path) -> Path | None:
    """The file or folder that a URI (`model://`, `package://`, `file://` or a path) in a file names; None = absent.

    Of an address in the web, a model of its name is looked for.
    """
    scheme, separator, rest = uri.strip().partition("://")
    if not separator:
        rest = scheme
    if scheme in ("http", "https"):
        rest = rest.rstrip("/").rpartition("/")[2]
    if os.path.isabs(rest):  # noqa: PTH117 - of a text
        candidates = [Path(rest)]
    else:
        candidates = [folder / rest for folder in search_folders(path)]
    return next((candidate for candidate in candidates if is_file(candidate) or is_dir(candidate)), None)
