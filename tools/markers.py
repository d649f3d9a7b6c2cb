"""Folders of the documentation, and functions to write whole pages or the parts between their markers."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
GENERATED = DOCS / "generated"
IMAGES = DOCS / "images"


def banner(command: str) -> str:
    """First line of a generated page.

    Args:
        command: Command that regenerates the page.
    """
    return f"<!-- Written by `{command}`; do not edit. -->\n\n"


def between(page: str, name: str, block: str) -> str:
    """Replace the text between a page's markers `<!-- name:begin -->` and `<!-- name:end -->`; returns the page.

    Raises:
        ValueError: The page does not contain both markers exactly once, in order.
    """
    begin = f"<!-- {name}:begin -->"
    end = f"<!-- {name}:end -->"
    if page.count(begin) != 1 or page.count(end) != 1 or page.index(begin) > page.index(end):
        raise ValueError(f"must hold {begin} and {end} once each, in this order")
    return f"{page.split(begin)[0]}{begin}\n{block.strip()}\n{end}{page.split(end)[1]}"


def with_others(heading: str, table: str, page: str, name: str) -> str:
    """What was measured on a processor, then what a page has of others.

    Args:
        heading: Name of the processor.
        table: What was measured; no line begins with `**`.
        page: The page with earlier tables between its markers, or none.
        name: Name of the markers.
    """
    tables = [f"**{heading}**\n\n{table}"]
    for part in re.split(r"(?m)^(?=\*\*)", block_of(page, name)):
        other = part.strip()
        if other and not other.startswith(f"**{heading}**"):
            tables.append(other)
    return "\n\n".join(tables)


def block_of(page: str, name: str) -> str:
    """The text between a page's markers; "" if it has none."""
    return page.partition(f"<!-- {name}:begin -->")[2].partition(f"<!-- {name}:end -->")[0].strip()


def fill(path: Path, blocks: dict[str, str]) -> None:
    """Write blocks between the markers of a page.

    Args:
        path: The page.
        blocks: New text by marker name.

    Raises:
        ValueError: Markers are missing, duplicated or out of order; the page is not modified.
    """
    page = path.read_text(encoding="utf-8")
    for name, block in blocks.items():
        try:
            page = between(page, name, block)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error
    path.write_text(page, encoding="utf-8")
