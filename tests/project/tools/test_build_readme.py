import json

import pytest

from tools import build_readme, published_digests
from tools.markers import DOCS, ROOT

TABLE = """**Instruction level, the paper's Table I: success rates, one fault per mission**

Generated on 2026-11-20 by mavfi 0.1.0 (numba 0.68.1): campaign `table1_instructions`.

|  |  | farm | dense |
| --- | --- | ---: | ---: |
| Golden run | here | 100.0 [77.2, 100.0] 13/13 | 100.0 [77.2, 100.0] 13/13 |
|  | paper | 100.0 | 85.0 |
| Injection run | here, node restarts | 100.0 [95.3, 100.0] 78/78 | 96.2 [89.3, 98.7] 75/78 |
|  | here, mission ends | 84.6 [74.6, 91.2] 66/78 | 80.8 [69.1, 88.7] 63/78 |
|  | paper | 97.3 | 75.3 |
| Gaussian-based | here, node restarts | 100.0 [95.3, 100.0] 78/78 | 98.7 [93.1, 99.8] 77/78 |
|  | paper | 99.3 | 83.0 |

- smaller differences are not distinguished: farm 16 / 4; dense 16 / 9
"""


def test_the_table_of_the_readme_has_our_rates_and_the_papers():
    assert build_readme.compact(TABLE).splitlines() == [
        "| missions that succeed, % (the paper's) | farm | dense |",
        "| --- | ---: | ---: |",
        "| Golden run | 100.0 (100.0) | 100.0 (85.0) |",
        "| Injection run | 100.0 (97.3) | 96.2 (75.3) |",
        "| Gaussian-based | 100.0 (99.3) | 98.7 (83.0) |",
        "",
        "One bit in one instruction per mission; a node that dies restarts; n = 13 to 78 per cell.",
    ]
    for other in ("", TABLE.replace("|  | paper | 99.3 | 83.0 |\n", "")):
        with pytest.raises(ValueError, match="not a success table"):
            build_readme.compact(other)


def test_the_headline_of_the_readme_is_that_of_the_results():
    results = (DOCS / "results.md").read_text(encoding="utf-8")
    block = results.partition("<!-- instruction_table:begin -->")[2].partition("<!-- instruction_table:end -->")[0]
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert build_readme.headline(block) in readme and build_readme.compact(block) in readme


@pytest.fixture
def documents(monkeypatch, tmp_path):
    """Pages without content, in the place of README.md and docs/results.md; the digests of a study are made up."""
    for name, markers in (("README.md", "headline digests"), ("results.md", "table instruction_table")):
        blocks = "".join(f"<!-- {marker}:begin -->\n<!-- {marker}:end -->\n" for marker in markers.split())
        (tmp_path / name).write_text(blocks, encoding="utf-8")
    for name in ("DOCS", "ROOT"):
        monkeypatch.setattr(build_readme, name, tmp_path)
    monkeypatch.setattr(build_readme, "RESULTS", tmp_path / "results")
    monkeypatch.setattr(build_readme, "TABLES", tmp_path / "results" / "tables")

    def entry(_, study):
        if study["scale"] == "other":
            raise ValueError("scale other")
        return {"program": "mavfi", "fingerprint": "", "ledgers": [["table1", "", f"digest of {study['scale']}"]]}

    monkeypatch.setattr(published_digests, "of_study", entry)
    return tmp_path


def study(folder, scale):
    """A folder with the files of a study."""
    (folder / "instructions").mkdir(parents=True)
    (folder / "readme_block.md").write_text("| state level |", encoding="utf-8")
    (folder / "instructions" / "readme_block.md").write_text(TABLE, encoding="utf-8")
    for name in ("figures", "tables"):
        (folder / name).mkdir()
    for name in ("figures/a.png", "tables/a.csv", "study.md"):
        (folder / name).write_text(name, encoding="utf-8")
    (folder / "study.json").write_text(json.dumps({"scale": scale}), encoding="utf-8")
    return folder


def test_both_pages_are_written(documents):
    assert build_readme.main(documents / "out") == 2
    for name in ("figures", "tables/study", "tables/other"):
        (documents / "results" / name).mkdir(parents=True)
        (documents / "results" / name / "old.csv").touch()
    assert build_readme.main(study(documents / "out", "paper")) == 0
    readme = (documents / "README.md").read_text(encoding="utf-8")
    assert "27 of 156" in readme and "| table1 |  | `digest of paper` |" in readme
    assert "| state level |" in (documents / "results.md").read_text(encoding="utf-8")
    copied = {str(path.relative_to(documents / "results")) for path in (documents / "results").rglob("*.*")}
    assert copied == {
        "figures/a.png",
        "tables/study/a.csv",
        "study.md",
        "digests.json",
        "tables/other/old.csv",
    }, "of the study alone"
    assert (documents / "results" / "study.md").read_text(encoding="utf-8").endswith("do not edit. -->\n\nstudy.md")


def test_a_study_whose_digests_are_not_those_of_the_program_changes_nothing(documents, capsys):
    before = (documents / "README.md").read_text(encoding="utf-8")
    assert build_readme.main(study(documents / "out", "other")) == 2
    assert "scale other" in capsys.readouterr().err
    assert (documents / "README.md").read_text(encoding="utf-8") == before
    assert not (documents / "results").exists()
