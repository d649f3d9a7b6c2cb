"""Figures as inline SVG: text remains text, colours follow the page's theme, points link to their runs."""

import io
import re
from html import escape
from urllib.parse import parse_qsl

from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.figure import Figure

from mavfi.reports import style

_COLOURS = {
    style.INK: "ink", style.GREY: "soft", style.PALE: "line", style.BLUE: "golden", style.ORANGE: "injected",
    style.GREEN: "recovered", style.PURPLE: "purple", style.AMBER: "amber", "#ffffff": "paper", "#000000": "ink",
}  # fmt: skip
"""Style sheet variables by colour."""


def svg_of(figure: Figure, name: str, caption: str) -> Markup:
    """Convert a figure to an SVG element.

    Args:
        figure: The figure.
        name: Prefix of ids, unique within the page.
        caption: Label for screen readers.
    """
    buffer = io.StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "mavfi"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None}, transparent=True)
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'(\bid="|url\(#|href="#)(?!runs\?)', rf"\g<1>{name}-", text)
    for colour, variable in _COLOURS.items():
        text = re.sub(re.escape(colour), f"var(--{variable})", text, flags=re.IGNORECASE)
    text = re.sub(r'<a xlink:href="#runs\?([^"]*)" target="_blank"', _link, text)
    text = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", text, count=1)
    label = escape(caption, quote=True)
    return Markup(text.replace("<svg ", f'<svg role="group" aria-label="{label}" ', 1))  # noqa: S704 - from matplotlib


def _link(found: re.Match[str]) -> str:
    """Rewrite a link, with a label for screen readers."""
    query = found[1].replace("&amp;", "&")
    told = ", ".join(f"{key.replace('_', ' ')} {value}" for key, value in parse_qsl(query))
    return f'<a href="#runs?{found[1]}" aria-label="{escape(f"runs: {told}", quote=True)}"'
