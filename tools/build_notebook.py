"""Write `examples/python_api.ipynb` from the code blocks of `docs/how-to/python-api.md`, executed in a kernel."""

import os
import re
import tempfile
from collections.abc import Callable
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbformat import NotebookNode

from tools.markers import DOCS, ROOT

PAGE = DOCS / "how-to" / "python-api.md"
NOTEBOOK = ROOT / "examples" / "python_api.ipynb"
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\((?!https?:)([^)]+)\)")


def cells(page: str) -> list[tuple[str, str]]:
    """Kind ("markdown" or "code") and text of each cell: the page, split at its Python blocks."""
    page_cells = []
    # the pattern has one group, so that its matches stand between the texts around them
    for index, part in enumerate(BLOCK.split(page)):
        text = part.strip()
        if not text:
            continue
        if index % 2:
            page_cells.append(("code", text))
        else:
            page_cells.append(("markdown", _relink(text)))
    return page_cells


def _relink(text: str) -> str:
    """Relocate links from the page to `examples`."""
    return LINK.sub(lambda link: f"]({os.path.relpath(PAGE.parent / link[1], NOTEBOOK.parent)})", text)


def notebook(page: str) -> NotebookNode:
    """The notebook of the page, without outputs."""
    notebook_cells = []
    for index, (kind, text) in enumerate(cells(page)):
        make: Callable[..., NotebookNode] = nbformat.v4.new_markdown_cell
        if kind == "code":
            make = nbformat.v4.new_code_cell
        notebook_cells.append(make(text, id=f"cell-{index}"))
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    book: NotebookNode = nbformat.v4.new_notebook(cells=notebook_cells, metadata={"kernelspec": kernel})
    return book


def execute(book: NotebookNode) -> NotebookNode:
    """Execute a notebook in a kernel, in an empty folder; returns it with its outputs."""
    with tempfile.TemporaryDirectory() as folder:
        client = NotebookClient(book, timeout=600, record_timing=False, resources={"metadata": {"path": folder}})
        return client.execute()


def main(target: Path = NOTEBOOK) -> None:
    """Write the notebook."""
    book = execute(notebook(PAGE.read_text(encoding="utf-8")))
    del book.metadata["language_info"]  # names the version of Python
    nbformat.write(book, target)


if __name__ == "__main__":
    main()
