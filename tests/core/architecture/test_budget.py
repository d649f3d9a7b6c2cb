"""The project stays as small as it is: `budget.toml` holds what each part may weigh.

Tokens of Python are counted because they measure what has to be read and kept working, and nobody saves any by writing
densely: comments and layout count nothing, a docstring counts one.
"""

import io
import sys
import tokenize
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.core.architecture.source import PACKAGE, ROOT

LAYOUT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}
LOOSE = 1.03
"""A budget may exceed what is there by this factor: beyond it, what was deleted would come back unnoticed."""
BUDGET = tomllib.loads((ROOT / "tests/core/architecture/budget.toml").read_text(encoding="utf-8"))


def tokens(folder: Path) -> int:
    """Tokens of all Python files below a folder, or of one file."""
    paths = [folder] if folder.is_file() else sorted(folder.rglob("*.py"))
    return sum(_tokens_of(path) for path in paths if "__pycache__" not in path.parts)


def _tokens_of(path: Path) -> int:
    readline = io.StringIO(path.read_text(encoding="utf-8")).readline
    return sum(token.type not in LAYOUT for token in tokenize.generate_tokens(readline))


def parts_of_source() -> Iterator[tuple[str, Path]]:
    """Folders of the package and of its extras, by name; files beside the folders together are `modules`."""
    for folder in sorted(PACKAGE.iterdir()):
        if not folder.is_dir() or not any(folder.rglob("*.py")):
            continue
        if folder.name != "extras":
            yield folder.name, folder
            continue
        for extra in sorted(folder.iterdir()):
            if any(extra.rglob("*.py")):
                yield f"extras/{extra.name}", extra


def weights() -> dict[str, dict[str, int]]:
    """What each part of `budget.toml` weighs now."""
    source = {name: tokens(folder) for name, folder in parts_of_source()}
    source["modules"] = sum(tokens(path) for path in PACKAGE.glob("*.py"))
    every_token = sum(source.values())
    extras = sum(weight for name, weight in source.items() if name.startswith("extras/"))
    return {
        "tokens": dict(sorted(source.items())),
        "tokens_in_all": {
            "src": every_token,
            "core": every_token - extras,
            "tests": tokens(ROOT / "tests"),
            "tools": tokens(ROOT / "tools"),
            "studies": tokens(ROOT / "studies"),
        },
        "lines": {
            "c": lines("*.c"),
            "templates": lines("*.j2"),
            "javascript": lines("*.js"),
        },
        "words": {"pages": words_of_pages()},
    }


def lines(pattern: str) -> int:
    """Lines of the project's own files of a kind in the package; vendored and built ones are left out."""
    others = {PACKAGE / "report" / "html" / "vendor", PACKAGE / "data" / "site"}
    paths = [path for path in PACKAGE.rglob(pattern) if not others & set(path.parents)]
    return sum(path.read_text(encoding="utf-8").count("\n") for path in paths)


def words_of_pages() -> int:
    """Words of all pages for people, generated ones too; the changelog grows by its nature."""
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]
    pages += (ROOT / "studies").rglob("*.md")
    return sum(len(page.read_text(encoding="utf-8").split()) for page in pages)


def as_toml(measured: dict[str, dict[str, int]]) -> str:
    """The tables of `budget.toml` with these weights."""
    rows = []
    for table, numbers in measured.items():
        rows.append(f"[{table}]")
        rows += [f'"{name}" = {number}' for name, number in numbers.items()]
    return "\n".join(rows)


MEASURED = weights()


@pytest.mark.parametrize("table", [name for name in BUDGET if name != "ceilings"])
def test_each_part_is_within_its_budget(table):
    assert BUDGET[table].keys() == MEASURED[table].keys()
    for name, budget in BUDGET[table].items():
        weight = MEASURED[table][name]
        assert weight <= budget, f"{table}.{name}: {weight}, budget {budget}: say who needs it, and what went instead"
        assert budget <= LOOSE * weight + 100, f"{table}.{name}: {weight}, budget {budget}: lower the budget"


def test_the_whole_is_below_the_ceilings():
    for name, ceiling in BUDGET["ceilings"].items():
        assert MEASURED["tokens_in_all"][name] <= ceiling, name


if __name__ == "__main__":
    sys.stdout.write(as_toml(MEASURED) + "\n")
