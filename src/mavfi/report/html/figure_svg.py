"""Figures as inline SVG: text remains text, colours follow the page's theme, points link to their runs."""

import io
import re
from html import escape, unescape
from urllib.parse import parse_qsl

from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.figure import Figure

from mavfi.report import style
from mavfi.report.figures import links
from mavfi.report.html.table_data import RunSets

_COLOURS = {
    style.INK: "ink", style.GREY: "soft", style.PALE: "line", style.BLUE: "golden", style.ORANGE: "injected",
    style.GREEN: "recovered", style.PURPLE: "purple", style.AMBER: "amber", "#ffffff": "paper", "#000000": "ink",
}  # fmt: skip
"""Style sheet variables by colour."""


def svg_of(figure: Figure, name: str, caption: str, sets: RunSets) -> Markup:
    """Convert a figure to an SVG element.

    Args:
        figure: The figure.
        name: Prefix of ids, unique within the page.
        caption: Label for screen readers.
        sets: Sets of runs of the page, to which those behind points are added.
    """
    buffer = io.StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "mavfi"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None}, transparent=True)
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(
        rf'\bid="{links.DOTS}([^"]*)"', lambda found: f'class="dots" data-runs="{sets.ordered(found[1].split())}"', text
    )
    text = re.sub(r'(\bid="|url\(#|href="#)(?!runs\?|run/)', rf"\g<1>{name}-", text)
    for colour, variable in _COLOURS.items():
        text = re.sub(re.escape(colour), f"var(--{variable})", text, flags=re.IGNORECASE)
    text = re.sub(r'<a xlink:href="(#runs?[?/][^"]*)" target="_blank"', lambda found: _link(found[1], sets), text)
    # without its height it scales; the style sheet limits the scale, so that the text of all figures has one size
    text = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", text, count=1)
    text = re.sub(r'(<svg[^>]*?) width="([^"]*)"', r'\1 style="--drawn: \2"', text, count=1)
    label = escape(caption, quote=True)
    return Markup(text.replace("<svg ", f'<svg role="group" aria-label="{label}" ', 1))  # noqa: S704 - from matplotlib


def _link(link: str, sets: RunSets) -> str:
    """Rewrite a link of `figures.links` for the page, with a label for screen readers."""
    if link.startswith(links.RUN):
        return f'<a href="{link}" aria-label="run {link.removeprefix(links.RUN)}"'
    label = dict(parse_qsl(unescape(link).removeprefix(links.RUNS)))
    run_ids = label.pop(links.IDS).split()
    values = ", ".join(f"{key.replace('_', ' ')} {value}" for key, value in label.items())
    count = "1 run" if len(run_ids) == 1 else f"{len(run_ids)} runs"
    return f'<a href="{sets.link(run_ids)}" aria-label="{escape(f"{count}: {values}", quote=True)}"'
