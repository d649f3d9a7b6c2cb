"""What the site adds to the pages of the documentation: mkdocs calls the functions `on_...` (`make site`).

Navigation: each section of an index page (docs/README.md, and the README.md of a folder that it links) becomes a
section of the menu, in the order of its links.  So a page is listed once, and strict mode refuses one that is not.

Links that leave docs: the site has a page `files/PATH` for each file or folder of the repository that a page links to,
since a reader of an installed package has no repository.
"""

import logging
import os
import posixpath
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from tools.draw_diagrams import DIAGRAM, picture_of
from tools.markers import DOCS, ROOT

INDEX = "README.md"
FILES = "files/"
"""Where the site has pages of files outside docs."""
LANGUAGES = {".py": "python", ".yaml": "yaml", ".yml": "yaml", ".xml": "xml", ".c": "c", ".sh": "bash", ".toml": "toml"}
"""Highlighting of files that are shown as a page, by extension; others are copied."""
_LOG = logging.getLogger("mkdocs.site")
_LINK = re.compile(r"(?<=\]\()(?![a-z]+:|#)([^)\s#]+)(#[^)\s]*)?(?=\))")
_SECTION = re.compile(r"^## (.+)\n", re.MULTILINE)
_ENTRY = re.compile(r"\[([^\]]+)\]\((?![a-z]+:|#)([^)\s#]+)\)")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Derive the navigation from the index pages; only warnings are printed (with `--quiet`, strict mode has none)."""
    logging.getLogger("mkdocs").setLevel(logging.WARNING)
    _, *sections = _SECTION.split((DOCS / INDEX).read_text(encoding="utf-8"))
    config.nav = [{"Home": INDEX}]
    for title, text in zip(sections[::2], sections[1::2], strict=True):
        config.nav.append({title: list(_entries(text))})
    return config


def _entries(section: str) -> Iterator[dict[str, Any]]:
    """Entries of the menu for the links of a section of docs/README.md."""
    for text, target in _ENTRY.findall(section):
        address = site_address(posixpath.normpath(posixpath.join("docs", target)))
        if not address.endswith(".md"):
            continue
        title = text.strip("`")
        title = title[0].upper() + title[1:]
        folder, name = posixpath.split(address)
        if name == INDEX and not address.startswith(FILES):
            yield {title: [address, *_pages_of(folder)]}
        else:
            yield {title: address}


def _pages_of(folder: str) -> list[str]:
    """Pages that the index page of a folder of docs links in this folder, in order."""
    text = (DOCS / folder / INDEX).read_text(encoding="utf-8")
    names = (target for _, target in _ENTRY.findall(text) if "/" not in target and target.endswith(".md"))
    return [f"{folder}/{name}" for name in dict.fromkeys(names)]


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add a page for every file and folder outside docs that a page links to, and for those that these link to."""
    waiting = [f"docs/{file.src_uri}" for file in files.documentation_pages()]
    while waiting:
        source = waiting.pop()
        path = ROOT / source
        if path.is_dir():
            linked = _content(path)
        elif path.suffix == ".md":
            linked = [_target(source, match[1]) for match in _LINK.finditer(path.read_text(encoding="utf-8"))]
        else:
            continue
        for target in linked:
            address = site_address(target)
            if address.startswith(FILES) and address not in files.src_uris and (ROOT / target).exists():
                files.append(_file_page(ROOT / target, address, config))
                waiting.append(target)
    return files


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Let links lead to the site's pages, and show diagrams as pictures."""
    address = page.file.src_uri
    source = f"docs/{address}"
    if address.startswith(FILES):
        source = address.removeprefix(FILES)
        if not source.endswith(".md") or (ROOT / source.removesuffix(".md")).exists():
            return markdown  # written below, for the site

    def relinked(match: re.Match[str]) -> str:
        target = site_address(_target(source, match[1]))
        return posixpath.relpath(target, posixpath.dirname(address)) + (match[2] or "")

    def drawn(match: re.Match[str]) -> str:
        picture = picture_of(match[1])
        if not (ROOT / picture).exists():
            _LOG.warning("%s: a diagram is not drawn; draw it with: python -m tools.draw_diagrams", source)
        link = posixpath.relpath(picture, posixpath.dirname(source))
        return f"[![diagram]({link})]({link})"  # opens in its full size

    return _LINK.sub(relinked, DIAGRAM.sub(drawn, markdown))


def site_address(target: str) -> str:
    """Address in the site, relative to its root, of a file or folder of the repository."""
    path = ROOT / target
    if path.is_dir() and path.is_relative_to(DOCS) and (path / INDEX).exists():
        return (path / INDEX).relative_to(DOCS).as_posix()
    if path.is_dir() or path.suffix in LANGUAGES:
        return f"{FILES}{target}.md"
    if path.is_relative_to(DOCS):
        return path.relative_to(DOCS).as_posix()
    return FILES + target


def _target(source: str, link: str) -> str:
    """The file or folder of the repository that a link on a page leads to; both relative to its root."""
    return posixpath.normpath(posixpath.join(posixpath.dirname(source), link))


def _content(folder: Path) -> list[str]:
    """Files below a folder, relative to the root of the repository."""
    paths = sorted(path for path in folder.rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    return [path.relative_to(ROOT).as_posix() for path in paths]


def _file_page(path: Path, address: str, config: MkDocsConfig) -> File:
    """The site's page of a file or folder outside docs; pages in Markdown and data are what they are."""
    name = path.relative_to(ROOT).as_posix()
    head = f"---\nsearch: {{exclude: true}}\n---\n\n# `{name}`\n\n"
    if path.is_dir():
        here = posixpath.dirname(address)
        links = [f"- [`{file}`]({posixpath.relpath(site_address(file), here)})" for file in _content(path)]
        return File.generated(config, address, content=head + "\n".join(links))
    if path.suffix in LANGUAGES:
        text = path.read_text(encoding="utf-8")
        return File.generated(config, address, content=f"{head}~~~~~~{LANGUAGES[path.suffix]}\n{text}~~~~~~\n")
    return File.generated(config, address, abs_src_path=os.fspath(path))


def on_post_build(config: MkDocsConfig) -> None:
    """Remove what no page loads: source maps, and the search's other languages (2 MB)."""
    scripts = Path(config.site_dir) / "assets" / "javascripts"
    shutil.rmtree(scripts / "lunr")
    for source_map in Path(config.site_dir).rglob("*.map"):
        source_map.unlink()
