"""The page of contracts: its smallest examples keep the contracts, and fly by its commands."""

import importlib
import json
import re
import shlex
import sys
from importlib.metadata import EntryPoint

import pytest

import mavfi
from mavfi import plugins
from mavfi.cli import run
from mavfi.faults import fault as faults
from tests.pages import DOCS, commands, files, importing_from

PAGE = "reference/contracts.md"
COMMANDS = commands(PAGE)
SUITES = ("TestCeiling", "TestDirect", "TestOffset", "TestWindy")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty working directory with the page's files in it, where its level is installed."""
    for name, content in files(PAGE):
        (tmp_path / name).write_text(content, encoding="utf-8")
    point = EntryPoint("offset", "my_level:OffsetLevel", "mavfi.levels")
    real = plugins.entry_points
    monkeypatch.setattr(plugins, "entry_points", lambda group: [*real(group=group), *[point] * (group == point.group)])
    with importing_from(tmp_path, monkeypatch):
        _forget_levels()
        yield tmp_path
    _forget_levels()


def _forget_levels():
    for cached in (faults.find_level, faults.level_names):
        cached.cache_clear()


@pytest.mark.slow
@pytest.mark.parametrize("suite", SUITES)
def test_an_example_keeps_its_contract(folder, suite):
    sys.modules.pop("test_my_parts", None)  # that of another folder
    page_tests = importlib.import_module("test_my_parts")
    contract = getattr(page_tests, suite)()
    checks = [name for name in dir(contract) if name.startswith("test_")]
    assert len(checks) >= 4 and {name for name in vars(page_tests) if name.startswith("Test")} == set(SUITES)
    for name in checks:
        getattr(contract, name)()


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.split()[-1])
def test_an_example_flies(folder, capsys, command):
    arguments = shlex.split(command)[1:]
    assert run([*arguments, "--json"]) == 0, capsys.readouterr().err
    data = json.loads(capsys.readouterr().out)
    assert data["status"] == "success" and len(COMMANDS) == 6
    assert [alarm["source"] for alarm in data["alarms"]] == ["ceiling"] * ("--detector" in arguments)
    assert all(injection["activated"] for injection in data["injections"])


def test_every_public_name_has_its_reference():
    page = (DOCS / "reference" / "api.md").read_text(encoding="utf-8")
    listed = {*re.findall(r"^::: mavfi\.(\w+)$", page, re.MULTILINE), *re.findall(r"`mavfi\.(\w+)`", page)}
    assert listed == set(mavfi.__all__) - {"__version__"}
