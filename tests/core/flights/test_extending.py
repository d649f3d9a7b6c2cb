"""The page for users' own parts: its blocks, written to an empty folder, fly by its commands."""

import json
import re
import shlex
import sys
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import pytest
from sklearn.neighbors import NearestNeighbors

from mavfi.analysis.runs import Runs
from mavfi.cli import run
from tests.night import at_night
from tests.pages import DOCS, commands, files, importing_from

PAGE = "how-to/extending.md"
COMMANDS = [command.removeprefix("mavfi ") for command in commands(PAGE) if command.startswith("mavfi ")]
FLIGHTS = [command for command in COMMANDS if command.startswith("fly")]


class NeighboursWithThePyodInterface:
    """Distance from the fifth nearest neighbour, as PyOD's `KNN`, where PyOD is not installed."""

    def fit(self, rows):
        self._neighbours = NearestNeighbors(n_neighbors=5).fit(rows)
        self.decision_scores_ = self._neighbours.kneighbors()[0][:, -1]
        return self

    def decision_function(self, rows):
        return self._neighbours.kneighbors(rows)[0][:, -1]


@pytest.fixture
def library_of_models(monkeypatch):
    """PyOD, or the one class of it that the page uses."""
    if find_spec("pyod") is None:
        for name in ("pyod", "pyod.models", "pyod.models.knn"):
            monkeypatch.setitem(sys.modules, name, ModuleType(name))
        sys.modules["pyod.models.knn"].KNN = NeighboursWithThePyodInterface


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty working directory with the page's files in it."""
    for name, content in files(PAGE):
        (tmp_path / name).write_text(content, encoding="utf-8")
    monkeypatch.delenv("MAVFI_ALLOW_PLUGINS")
    with importing_from(tmp_path, monkeypatch):
        yield tmp_path


def test_every_block_names_its_file():
    page = (DOCS / PAGE).read_text(encoding="utf-8")
    assert sum(page.count(f"\n```{language}\n") for language in ("python", "yaml", "xml")) == len(files(PAGE))


@pytest.mark.slow
@pytest.mark.parametrize("command", [*FLIGHTS[::3], *at_night(*FLIGHTS[1::3], *FLIGHTS[2::3])])
def test_the_commands_of_the_page_fly(folder, library_of_models, capsys, command):
    assert run([*shlex.split(command), "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["status"] == "success"
    arguments = shlex.split(command)
    for option in ("planner", "autopilot", "vehicle", "environment"):
        if f"--{option}" in arguments and (value := arguments[arguments.index(f"--{option}") + 1]).endswith(".yaml"):
            name = re.search(r"^name: (\w+)", (folder / value).read_text(encoding="utf-8"), re.MULTILINE)[1]
            assert data[option] == name
    if "--detector" in arguments:
        source = arguments[arguments.index("--detector") + 1].partition(":")[2].lower()
        assert [alarm["source"] for alarm in data["alarms"]] == [source]


@pytest.mark.slow
def test_a_campaign_takes_all_of_it(folder, capsys):
    (command,) = (c for c in COMMANDS if c.startswith("campaign"))
    assert run([*shlex.split(command), "--workers", "1"]) == 0
    capsys.readouterr()
    assert run(["campaign", "status", "mine", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["complete"] and data["settings"]["golden"]["succeeded"] == 1
    runs = Runs.read(Path("mine"))
    assert set(runs["environment"]) == {"pillars"} and all(name.startswith("pillars-") for name in runs["run_id"])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--map", "my_map:Careless"], "map 'my_map:Careless': cannot be imported"),
        (["--map", "my_world:pillars"], "map 'my_world:pillars': cannot be built"),
        (["--map", "grid"], "map 'grid': not known; allowed: dense, octree, or package:Class"),
        (["--vehicle", "none.yaml"], "none.yaml: cannot be read"),
        (["--vehicle", "glider"], "vehicle 'glider': not known; allowed: airsim_quad, small_quad, or a path"),
        (["--planner", "my_world:pillars"], "planner 'my_world:pillars': cannot be built"),
        (["--autopilot", "my_planner.yaml"], "my_planner.yaml: unknown key 'range'"),
    ],
)
def test_what_does_not_fit_is_one_line(folder, capsys, arguments, message):
    assert run(["fly", "--environment", "sparse", "--seed", "7", *arguments]) == 2
    stderr = capsys.readouterr().err
    assert message in stderr and stderr.count("\n") == 1


def test_a_plugin_that_exits_does_not_choose_the_exit_code(folder, capsys):
    page = folder / "my_detector.py"
    text = page.read_text(encoding="utf-8")
    page.write_text(
        text.replace("    def check(", "    def start(self):\n        raise SystemExit(0)\n\n    def check(", 1),
        encoding="utf-8",
    )
    assert run(["fly", "--environment", "sparse", "--seed", "7", "--detector", "my_detector:Altitude"]) == 2
    stderr = capsys.readouterr().err
    assert "my_detector:Altitude: SystemExit: 0 (my_detector.py:8, start)" in stderr and stderr.count("\n") == 1


def test_code_that_only_a_file_names_is_not_run(folder, capsys):
    (folder / "my_world.py").write_text("raise SystemExit('it was run')\n", encoding="utf-8")
    assert run(["fly", "--environment", "pillars.yaml", "--seed", "1"]) == 2
    stderr = capsys.readouterr().err
    assert stderr == (
        "mavfi: pillars.yaml: key 'generator': generator 'my_world:pillars': named in a file, and so not run; allowed: "
        "entry points of installed packages, or any with --allow-plugins\n"
    )


def test_a_model_that_is_absent_is_one_line(folder, capsys):
    (folder / "my_quad.xml").unlink()
    assert run(["fly", "--vehicle", "my_quad.yaml"]) == 2
    assert capsys.readouterr().err == "mavfi: my_quad.yaml: key 'mjcf': my_quad.xml: there is no such file\n"


def test_the_view_of_the_page_is_a_table_of_a_report(folder, tmp_path_factory, monkeypatch):
    from my_views import CHAPTER  # of the page

    from mavfi.campaign.executors.local import LocalExecutor
    from tests.campaigns import run_campaign
    from tests.core.unit.campaign.fakes import small

    monkeypatch.setenv("MAVFI_ALLOW_PLUGINS", "all")
    ledger = tmp_path_factory.mktemp("parity")
    run_campaign(small(missions=4, faults=8), ledger, executor=LocalExecutor(1))
    (view,) = CHAPTER.members
    table = view.table(Runs.read(ledger))
    assert {row[0] for row in table.rows} == {"even", "odd"}
    assert not any("unknown" in note for note in table.notes)
