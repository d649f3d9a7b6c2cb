"""Write `examples/python_api.ipynb` from the code blocks of `docs/how-to/python-api.md`, with their outputs."""

import ast
import base64
import io
import json
import os
import re
import tempfile
from contextlib import chdir
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

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


def execute(source: str, names: dict[str, Any]) -> Any:  # noqa: ANN401 (whatever a cell answers)
    """Run a cell; returns the value of its last line if that is an expression, otherwise None."""
    tree = ast.parse(source)
    if not tree.body or not isinstance(tree.body[-1], ast.Expr):
        exec(compile(tree, PAGE.name, "exec"), names)
        return None
    exec(compile(ast.Module(tree.body[:-1], []), PAGE.name, "exec"), names)
    return eval(compile(ast.Expression(tree.body[-1].value), PAGE.name, "eval"), names)


def display(answer: Any) -> dict[str, str]:  # noqa: ANN401
    """Notebook representation of a value: content by media type."""
    if isinstance(answer, Figure):
        buffer = io.BytesIO()
        answer.savefig(buffer, format="png", dpi=110)
        return {"image/png": base64.b64encode(buffer.getvalue()).decode()}
    contents = {"text/plain": repr(answer)}
    html = getattr(answer, "_repr_html_", None)
    if html is not None:
        contents["text/html"] = html()
    return contents


def execute_page(page: str) -> list[dict[str, Any]]:
    """The cells of the notebook, executed in order in an empty folder."""
    names: dict[str, Any] = {}
    notebook_cells: list[dict[str, Any]] = []
    execution_count = 0
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        for index, (kind, text) in enumerate(cells(page)):
            cell: dict[str, Any] = {"cell_type": kind, "id": f"cell-{index}", "metadata": {}, "source": text}
            if kind == "code":
                execution_count += 1
                answer = execute(text, names)
                cell["execution_count"] = execution_count
                cell["outputs"] = []
                if answer is not None:
                    output = {"data": display(answer), "execution_count": execution_count, "metadata": {}}
                    cell["outputs"] = [{"output_type": "execute_result", **output}]
            notebook_cells.append(cell)
    return notebook_cells


def notebook(notebook_cells: list[dict[str, Any]]) -> str:
    """The notebook (nbformat 4.5) of the cells."""
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    book = {"cells": notebook_cells, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(book, indent=1, ensure_ascii=False) + "\n"


def main(target: Path = NOTEBOOK) -> None:
    """Write the notebook."""
    target.write_text(notebook(execute_page(PAGE.read_text(encoding="utf-8"))), encoding="utf-8")


if __name__ == "__main__":
    main()
