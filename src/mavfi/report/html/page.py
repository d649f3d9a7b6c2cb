"""Rendering of pages from Jinja2 templates, with style sheet, scripts and data inlined."""

import base64
import json
import re
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from mavfi.record import plain
from mavfi.report.html.time_lines import AFTER, BEFORE
from mavfi.version import __version__


def encoded(values: np.ndarray, kind: str) -> str:
    """Encode an array as base64 of little-endian numbers of a NumPy type, e.g. "f4", for decoding by scripts."""
    return base64.b64encode(np.ascontiguousarray(values, f"<{kind}").tobytes()).decode()


def as_json(data: Any) -> Markup:
    """Serialize plain data as JSON that is safe in a `<script>` element."""
    text = json.dumps(plain(data), separators=(",", ":"), allow_nan=False, ensure_ascii=False)
    return Markup(text.replace("<", "\\u003c"))  # noqa: S704 - without "<", nothing can end the element


def with_code(text: str) -> Markup:
    """Escape text, and show what stands between backticks as code."""
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text))))  # noqa: S704 - escaped


@cache
def _resource(name: str) -> Markup:
    """A file of this package, inlined verbatim."""
    text = files(__package__).joinpath(name).read_text(encoding="utf-8")
    return Markup(text)  # noqa: S704 - own and vendored files; see `vendor`


@cache
def _environment() -> Environment:
    found = Environment(
        loader=PackageLoader("mavfi.report", "html"), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    found.globals |= {"resource": _resource, "version": __version__, "before": f"{BEFORE:g}", "after": f"{AFTER:g}"}
    found.filters |= {"as_json": as_json, "with_code": with_code}
    return found


def render(template: str, **values: Any) -> str:
    """Render a page as text."""
    return _environment().get_template(template).render(**values)


def size_of(data: Sequence[Any] | dict[str, Any]) -> int:
    """Size of plain data in a page (bytes)."""
    return len(as_json(data).encode())
