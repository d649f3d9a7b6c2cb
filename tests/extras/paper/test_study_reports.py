"""The report of a study: of its folder, and by several processes."""

import shutil
import subprocess
import sys

import pytest

from mavfi.cli import run
from mavfi.extras.paper import cli_report as study_report
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


@pytest.mark.slow
def test_several_processes_write_the_same_reports_of_a_study(flown, tmp_path):
    study = Study(name="two", campaigns={"states": "table1"})
    write = (
        "import sys; from pathlib import Path\n"
        "from mavfi.extras.paper.study import Study; from mavfi.extras.paper import cli_report as study_report\n"
        "assert not study_report._polars_has_threads()\n"
        "study = Study.model_validate_json(sys.argv[1])\n"
        "study_report.write_study_report(study, 'quick', Path(sys.argv[2]), None, 0, 2)"
    )
    for way in ("one", "two"):
        shutil.copytree(flown, tmp_path / way / "states")
    written, _ = study_report.write_study_report(study, "quick", tmp_path / "one", None, 0, 1)
    assert study_report._polars_has_threads()  # private: what decides on the way, which else would pass unseen
    subprocess.run([sys.executable, "-c", write, study.model_dump_json(), str(tmp_path / "two")], check=True)
    files = {path.relative_to(tmp_path / "one") for path in (tmp_path / "one").rglob("*") if path.is_file()}
    assert len(files) >= 6 and {path.name for path in written.files} <= {file.name for file in files}
    for file in files:
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes(), file
