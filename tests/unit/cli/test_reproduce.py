import json

import pytest

from mavfi.campaign.config import Campaign
from mavfi.cli import reproduce, run
from mavfi.cli.progress import Bar
from tools import build_readme


@pytest.fixture
def small(monkeypatch):
    """Tables of one environment and one mission instead of the paper's; the training flights are three."""
    both = {"environments": ["sparse"], "flights": 1, "faults": 1, "detectors": {"gaussian": {"detector": "gaussian"}}}
    states = {"name": "table1", "null_runs": 1, "strata": {"sign_exponent": 1}}
    instructions = {"name": "table1_instructions", "null_runs": 0, "law": "kernels",
                    "kernels": {"names": ["rrt_connect", "pid"], "share": "stage", "which": "data"}}  # fmt: skip
    campaigns = {own["name"]: Campaign.model_validate({**both, **own}) for own in (states, instructions)}
    monkeypatch.setattr("mavfi.campaign.config.load_campaign", campaigns.__getitem__)
    monkeypatch.setattr(reproduce, "TRAINING_FLIGHTS", 3)


@pytest.mark.slow
def test_it_trains_flies_prints_and_writes_and_goes_on_where_it_stopped(capsys, tmp_path, small, monkeypatch):
    arguments = ["reproduce", "--out", str(tmp_path / "out"), "--workers", "1"]
    assert run(arguments) == 0
    text = capsys.readouterr().out
    assert "Success of missions" in text and "It took" in text
    titles = ("State level: success rates", "Instruction level, the paper's Table I: success rates")
    assert 0 <= text.index(titles[0]) < text.index(titles[1])
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"campaign.sqlite", "models", "report.md", "readme_block.md", "summary.json", "success.png"} <= names

    check_readme(tmp_path / "out", tmp_path, titles, monkeypatch)

    def never(*_, **__):
        raise AssertionError("trained again")

    monkeypatch.setattr("mavfi.campaign.training.train", never)
    assert run([*arguments, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["campaign"]["name"] == "table1"
    assert told["instructions"]["campaign"]["name"] == "table1_instructions"


def check_readme(out, root, titles, monkeypatch):
    """The page gets both tables, each in its place."""
    (root / "docs" / "images").mkdir(parents=True)
    page = "<!-- {0}:begin -->\nold\n<!-- {0}:end -->\n"
    (root / "README.md").write_text(page.format("table") + page.format("instruction_table"), encoding="utf-8")
    monkeypatch.setattr(build_readme, "ROOT", root)
    assert build_readme.main(out) == 0
    first, second = (root / "README.md").read_text(encoding="utf-8").split("<!-- table:end -->")
    assert titles[0] in first and titles[1] not in first
    assert titles[1] in second and "campaign `table1_instructions`" in second and "\nold\n" not in first + second


def test_a_readme_without_tables_is_left_alone(capsys, tmp_path):
    assert build_readme.main(tmp_path) == 2
    assert "run `make reproduce` first" in capsys.readouterr().err


@pytest.mark.slow
def test_training_that_is_stopped_goes_on(capsys, tmp_path, small, monkeypatch):
    out = tmp_path / "out"
    show, told = Bar.show, []

    def stop(bar, done, total):
        told.append((done, total))
        show(bar, done, total)
        if done == 2 and len(told) > 1:
            raise KeyboardInterrupt

    monkeypatch.setattr(Bar, "show", stop)
    assert run(["reproduce", "--out", str(out), "--workers", "1"]) == 130
    assert "the same command goes on" in capsys.readouterr().err
    assert told == [(0, 3), (1, 3), (2, 3)] and not list((out / "models").glob("*.json"))
    told.clear()
    assert run(["reproduce", "--out", str(out), "--workers", "1"]) == 0
    assert told == [(2, 3), (3, 3)]
    assert len(list((out / "models").glob("*.json"))) == 4 and not (out / "models" / ".flights").exists()
