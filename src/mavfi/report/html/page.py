"""Rendering of pages from Jinja2 templates, with style sheet, scripts and data inlined."""

import base64
import json
import re
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

from mavfi.errors import write_text
from mavfi.record import plain
from mavfi.version import __version__

BEFORE = 1.0
AFTER = 4.0
"""Time window of time lines before and after the fault (s)."""


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
def _environment(*folders: Path) -> Environment:
    """Environment of the templates in these folders and in that of this module."""
    loader = FileSystemLoader([*folders, Path(__file__).parent])
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )

    @cache
    def resource(name: str) -> Markup:
        """A file beside the templates, inlined verbatim."""
        text, _, _ = loader.get_source(environment, name)
        return Markup(text)  # noqa: S704 - own and vendored files; see `vendor`

    environment.globals |= {
        "resource": resource,
        "version": __version__,
        "before": f"{BEFORE:g}",
        "after": f"{AFTER:g}",
    }
    environment.filters |= {"as_json": as_json, "with_code": with_code}
    return environment


def render(template: str, /, *folders: Path, **values: Any) -> str:
    """Render a page as text; templates and resources of extras are found in their own folders first."""
    return _environment(*folders).get_template(template).render(**values)


def write(path: Path, template: str, /, *folders: Path, **values: Any) -> Path:
    """Render a page, and write it; `BadInputError` if the file cannot be written."""
    write_text(path, render(template, *folders, **values))
    return path
