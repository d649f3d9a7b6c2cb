"""`mavfi docs`: the documentation in the browser, from the installed files."""

import re
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from mavfi.errors import BadInputError, allowed, hint

HELP_PANEL = "Tools"
SITE = Path(__file__).parents[1] / "data" / "site"
"""Where `make site` builds it."""
HOME = "index"
_SECTION = re.compile(r'<h2 id="([^"]+)"')


def docs(
    page: Annotated[
        str, typer.Argument(help="A page, by name (fault-model), or a section of the first one (tutorials).")
    ] = HOME,
    path: Annotated[bool, typer.Option("--path", help="Print its address, and open nothing.")] = False,
) -> None:
    """Open the documentation in the browser; no network is needed.

    Example: [bold]mavfi docs tutorials[/bold]
    """
    address = address_of(page, SITE)
    if path or not webbrowser.open(address):
        typer.echo(address)


def _in_checkout(name: str) -> str:
    """Where a page can be read in the repository, or which page is meant; "" = there is no repository."""
    folder = Path(__file__).parents[3] / "docs"
    pages = {path.stem: path for path in sorted(folder.rglob("*.md"), reverse=True)} | {HOME: folder / "README.md"}
    if name in pages and pages[name].is_file():
        return f"read {pages[name]}, or "
    if not folder.is_dir():
        return ""
    return f"page {name!r}: not known{hint(name, pages)}; read {folder / 'README.md'}, or "


def address_of(name: str, site: Path) -> str:
    """Address of a page or section, for a browser.

    Args:
        name: Name of the page, with or without its folder, or anchor of a section of the first page.
        site: Folder of the site.

    Raises:
        BadInputError: The site was not built, or has no such page.
    """
    home = site / f"{HOME}.html"
    if not home.is_file():
        raise BadInputError(f"{site}: the pages are not built; {_in_checkout(name)}build them with: make site")
    addresses = {section: f"{home.as_uri()}#{section}" for section in _SECTION.findall(home.read_text("utf-8"))}
    for file in sorted(site.rglob("*.html"), key=lambda file: len(file.parts), reverse=True):
        if "files" not in file.relative_to(site).parts:  # these show files of the repository
            addresses[file.stem] = file.as_uri()  # the one nearest to the root counts
            addresses[file.relative_to(site).with_suffix("").as_posix()] = file.as_uri()
    if name not in addresses:
        names = [address for address in addresses if "/" not in address]
        raise BadInputError(f"page {name!r}: not known{hint(name, names)}; allowed: {allowed(names, name)}")
    return addresses[name]
