"""Where the documentation is, and the two ways to write it: between the markers of a page, or a whole page."""

from pathlib import Path

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
GENERATED = DOCS / "generated"
IMAGES = DOCS / "images"


def banner(command: str) -> str:
    """First line of a page that a command writes.

    Args:
        command: What a reader types to write the page again.
    """
    return f"<!-- Written by `{command}`; do not edit. -->\n\n"


def between(page: str, name: str, block: str) -> str:
    """The page with the block between its markers `<!-- name:begin -->` and `<!-- name:end -->`.

    Raises:
        ValueError: The page does not have the two markers once each, in order.
    """
    begin, end = f"<!-- {name}:begin -->", f"<!-- {name}:end -->"
    if page.count(begin) != 1 or page.count(end) != 1 or page.index(begin) > page.index(end):
        raise ValueError(f"must hold {begin} and {end} once each, in this order")
    return f"{page.split(begin)[0]}{begin}\n{block.strip()}\n{end}{page.split(end)[1]}"


def fill(path: Path, blocks: dict[str, str]) -> None:
    """Write blocks between the markers of a page.

    Args:
        path: The page.
        blocks: New text by name of the markers.

    Raises:
        ValueError: Markers are absent, doubled, or out of order; the page is left as it was.
    """
    page = path.read_text(encoding="utf-8")
    for name, block in blocks.items():
        try:
            page = between(page, name, block)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error
    path.write_text(page, encoding="utf-8")
