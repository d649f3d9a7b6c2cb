"""The page of the Python API: its blocks run, one after the other."""

import re
from pathlib import Path

import pytest

import mavfi

PAGE = Path(__file__).parents[2] / "docs" / "python-api.md"
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@pytest.mark.slow
def test_the_blocks_of_the_page_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {}
    for block in BLOCK.findall(PAGE.read_text(encoding="utf-8")):
        exec(compile(block, PAGE.name, "exec"), names)
    assert names["golden"].status is mavfi.MissionStatus.SUCCESS
    assert names["injected"].golden is not None and names["injected"].effect is not None
    assert len(names["runs"]) == names["runs"].frame.height > 8


def test_names_of_the_page_are_public():
    named = set(re.findall(r"\bmavfi\.(\w+)", PAGE.read_text(encoding="utf-8")))
    assert named <= set(dir(mavfi))
