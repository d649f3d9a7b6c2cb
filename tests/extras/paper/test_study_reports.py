"""The report of a study: of its folder, and by several processes."""

import shutil

from mavfi.cli import run
from mavfi.extras.paper.report import write_study
from mavfi.extras.paper.study import Study
from tests.core.unit.cli import test_report
from tests.core.unit.cli.test_report import printed

flown = test_report.flown


def test_a_study_needs_no_campaign_in_its_own_folder(capsys, flown, tmp_path):
    shutil.copytree(flown, tmp_path / "states")
    write_study(Study(name="two", campaigns={"states": "table1"}), "quick", tmp_path)
    text = printed(capsys, "report", tmp_path, "--figures", tmp_path / "out")
    assert "State level: success rates" in text and "wrote study.md, study.json, tables (1) in " in text
    shutil.rmtree(tmp_path / "states")
    assert run(["report", str(tmp_path)]) == 2
    assert f"{tmp_path / 'states'}: holds no campaign" in capsys.readouterr().err
