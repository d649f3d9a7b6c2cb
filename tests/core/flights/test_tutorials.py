"""The tutorials, as a newcomer follows them: files written to an empty folder, commands in order, what they print."""

import re

import pytest

from tests.night import at_night
from tests.pages import DOCS, follow, importing_from

PAGES = ("tutorials/own-kernels.md", "tutorials/own-detector.md")
LESSON = "tutorials/one-bit.md"
FEWER = (
    (r"environments: .*", "environments: [dense]"),
    (r"missions: \d+", "missions: 1"),
    (r"faults: \d+", "faults: 1"),
    (r"kernels: .*", "kernels: [UpAndOver]"),
    (r"  autoencoder: .*\n", ""),
)
"""Makes a campaign of a page small."""
BLOCK = re.compile(r"^```python\n(.*?)^```\n\n(?:^```text\n(.*?)^```$)?", re.MULTILINE | re.DOTALL)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty working directory, a terminal of 80 columns, and a user who has allowed nothing."""
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.delenv("MAVFI_ALLOW_PLUGINS", raising=False)
    with importing_from(tmp_path, monkeypatch):
        yield tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("page", [PAGES[1], *at_night(PAGES[0])])
def test_a_tutorial_can_be_followed(page, folder, capsys):
    follow(page, folder, capsys, FEWER)


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("page", PAGES)
def test_a_tutorial_prints_what_its_page_shows(page, folder, capsys):
    follow(page, folder, capsys)


@pytest.mark.slow
def test_the_lesson_answers_what_its_page_shows(folder, capsys):
    names = {}
    blocks = BLOCK.findall((DOCS / LESSON).read_text(encoding="utf-8"))
    assert len(blocks) == 5
    for source, shown in blocks:
        exec(source, names)
        assert capsys.readouterr().out == shown
