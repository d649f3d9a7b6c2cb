"""The documentation keeps up with the code."""

import re
from pathlib import Path

import pytest
import typer

from mavfi.cli.commands import app
from mavfi.detectors.registry import detector_names
from mavfi.dropped import OPTIONS
from tests.core.architecture.source import ROOT
from tools import build_pages, results

PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "tests/README.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "studies").rglob("*.md")),
]
DOCS = ROOT / "docs"
MAX_WORDS = 35_000
"""Hand-written words of all pages: what a reader can be expected to find a way through."""
NOT_PROSE = (
    r"<!-- ([\w-]+):begin.*?<!-- \1:end -->",  # written by a tool
    r"^```.*?^```",
    r"(?<=\n\n)(?: {4}[^\n]*\n)+",  # commands
    r"^::: \S+$",  # docstrings
)


def text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


@pytest.mark.slow
def test_written_pages_say_what_the_code_says():
    stale = [path.name for path, content in build_pages.pages().items() if text(path) != content]
    assert stale == [], "run `make docs`"


@pytest.mark.parametrize(
    "page", sorted([*(DOCS / "generated").glob("*.md"), *(DOCS / "results").glob("*.md")]), ids=lambda page: page.name
)
def test_generated_pages_name_the_command_that_writes_them(page):
    command = r"(<!-- Written by `(make|python -m) ([\w.-]+)(?: NAME=([a-z-]+))?(?: SCALE=paper)?`; do not edit\. -->)"
    banner, program, target, name = re.match(rf"{command}\n\n# ", text(page)).groups()
    if program == "python -m":
        assert (ROOT / target.replace(".", "/") / "__main__.py").is_file(), banner
        return
    assert f"\n{target}: " in text(ROOT / "Makefile"), banner
    assert name is None or name == page.stem and name in {*results.CAMPAIGNS, *results.MODULES}, banner


@pytest.mark.parametrize("page", sorted((DOCS / "results").glob("*.md")), ids=lambda page: page.name)
def test_a_page_of_results_links_all_of_its_tables(page):
    tables = {path.relative_to(page.parent).as_posix() for path in (results.TABLES / page.stem).glob("*.csv")}
    assert tables and tables <= set(re.findall(r"\]\(([^)#]+)", text(page)))


def count_words(page: str) -> int:
    """Words that a person wrote: tokens with a letter or a digit, without code and without what tools write."""
    for pattern in NOT_PROSE:
        page = re.sub(pattern, "", page, flags=re.DOTALL | re.MULTILINE)
    return sum(any(character.isalnum() for character in token) for token in page.split())


def test_pages_are_no_longer_than_somebody_reads():
    pages = [*(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md"))]
    pages += [page for page in DOCS.rglob("*.md") if not text(page).startswith("<!-- Written by")]
    word_counts = {page.relative_to(ROOT).as_posix(): count_words(text(page)) for page in pages}
    longest = sorted(word_counts, key=lambda name: -word_counts[name])[:5]
    assert sum(word_counts.values()) <= MAX_WORDS, f"longest: {longest}"
    assert count_words("one two\n\n    mavfi fly\n\n<!-- a:begin -->\nthree\n<!-- a:end -->\n| - | 4 |\n") == 3


def test_every_detector_is_listed():
    overview = text(DOCS / "reference" / "detectors.md").partition("\n## ")[0]
    cells = [line.split("|")[1] for line in overview.splitlines() if line.startswith("| `")][1:]
    assert sorted(name for cell in cells for name in re.findall(r"`([^`]+)`", cell)) == sorted(detector_names())


PRESENT = [page for page in PAGES if page.name != "CHANGELOG.md"]
"""Pages of what there is; the changelog names what there was."""


@pytest.mark.parametrize("page", PRESENT, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_make_targets_that_are_named_exist(page):
    targets = set(re.findall(r"^([a-z-]+):", text(ROOT / "Makefile"), flags=re.MULTILINE))
    named = set(re.findall(r"`make ([a-z-]+)[ `]", text(page))) | set(
        re.findall(r"^ *make ([a-z-]+)(?= |$)", text(page), re.MULTILINE)
    )
    assert named - targets == set()


def commands_of(page):
    """Every `mavfi ...` of a page, in blocks and in the text, as words."""
    shown = re.findall(r"^ {4}(?:\.venv/bin/|\$FLIGHT/join )?mavfi (.+)$", text(page), re.MULTILINE)
    shown += re.findall(r"`(?:\.venv/bin/)?mavfi ([^`]+)`", text(page))
    return [re.sub(r"\s+#.*$", "", command).split() for command in shown]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_commands_that_are_named_exist(page):
    program = typer.main.get_command(app)
    for command_words in commands_of(page):
        command = program
        while command_words and command_words[0] in getattr(command, "commands", {}):
            command = command.commands[command_words.pop(0)]
        assert command is not program, f"mavfi {' '.join(command_words)}"
        known_options = {
            option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)
        }
        options = {word.partition("=")[0] for word in command_words if re.match(r"--[a-z]", word)}
        everywhere = {option for parameter in program.params for option in parameter.opts} | {"--help"}
        if page.name == "CHANGELOG.md":
            everywhere |= {name.split()[-1] for name in OPTIONS}  # what earlier versions had
        assert options <= known_options | everywhere, f"{command.name}: {options - known_options}"


def test_every_test_that_is_named_exists():
    tests = ROOT / "tests"
    rows = [line for line in text(tests / "README.md").splitlines() if line.startswith("| ")]
    missing = []
    for row in rows:
        path = tests
        for file, name in re.findall(r"`([^`:]*)(?:::(\w+))?`", row.rpartition(" | ")[2]):
            if file:  # otherwise the test is in the file before it
                path = tests / file
            if not path.exists() or (name and f"def {name}(" not in text(path)):
                missing.append(f"{path.relative_to(tests)}::{name}")
    assert rows and missing == []


def test_decisions_are_numbered_without_gaps_and_say_their_status():
    records = sorted((DOCS / "adr").glob("[0-9]*.md"))
    assert [int(record.name[:4]) for record in records] == list(range(1, len(records) + 1))
    for record in records:
        assert "Status:" in text(record) and "## Consequences" in text(record), record.name


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_no_page_names_a_folder_of_the_machine_that_wrote_it(page):
    assert re.findall(rf"{re.escape(str(ROOT))}|(?<![\w.~>)])/(?:tmp|home|root|work|Users)/\w[^\s:]*", text(page)) == []
