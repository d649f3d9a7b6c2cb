import pytest

from tools import build_readme
from tools.markers import DOCS, ROOT

TABLE = """**Instruction level, the paper's Table I: success rates, one fault per mission**

Generated on 2026-11-20 by mavfi 0.1.0 (numba 0.68.1): campaign `table1_instructions`.

|  |  | farm | dense |
| --- | --- | ---: | ---: |
| Golden run | here | 100.0 [77.2, 100.0] 13/13 | 100.0 [77.2, 100.0] 13/13 |
|  | paper | 100.0 % | 85.0 % |
| Injection run | here, node restarts | 100.0 [95.3, 100.0] 78/78 | 96.2 [89.3, 98.7] 75/78 |
|  | here, mission ends | 84.6 [74.6, 91.2] 66/78 | 80.8 [69.1, 88.7] 63/78 |
|  | paper | 97.3 % | 75.3 % |
| Gaussian-based | here, node restarts | 100.0 [95.3, 100.0] 78/78 | 98.7 [93.1, 99.8] 77/78 |
|  | paper | 99.3 % | 83.0 % |

- smaller differences are not distinguished: farm 16 / 4; dense 16 / 9
"""


def test_rows_are_summed_over_environments():
    assert build_readme.totals(TABLE) == {
        ("Golden run", "here"): (26, 26), ("Injection run", "here, node restarts"): (153, 156),
        ("Injection run", "here, mission ends"): (129, 156), ("Gaussian-based", "here, node restarts"): (155, 156),
    }  # fmt: skip


def test_the_headline_says_what_the_table_says():
    line = build_readme.headline(TABLE)
    assert "fails 27 of 156 missions (17.3 %)**" in line and "3 of 156 missions (1.9 %) if the node restarts" in line
    assert "1 of 156 missions (0.6 %) if a Gaussian" in line and "26 of 26 missions succeed" in line
    assert "mavfi 0.1.0, 2026-11-20" in line


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
    for other in ("", TABLE.replace("|  | paper | 99.3 % | 83.0 % |\n", "")):
        with pytest.raises(ValueError, match="not a success table"):
            build_readme.compact(other)


@pytest.mark.parametrize("block", ["", TABLE.replace("Gaussian-based", "Other"), TABLE.replace("Generated on", "On")])
def test_another_table_is_refused(block):
    with pytest.raises(ValueError, match="not a success table"):
        build_readme.headline(block)


def test_the_headline_of_the_readme_is_that_of_the_results():
    results = (DOCS / "results.md").read_text(encoding="utf-8")
    block = results.partition("<!-- instruction_table:begin -->")[2].partition("<!-- instruction_table:end -->")[0]
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert build_readme.headline(block) in readme and build_readme.compact(block) in readme


def test_both_pages_are_written(monkeypatch, tmp_path):
    for name, markers in (("README.md", "headline"), ("results.md", "table instruction_table")):
        blocks = "".join(f"<!-- {marker}:begin -->\n<!-- {marker}:end -->\n" for marker in markers.split())
        (tmp_path / name).write_text(blocks, encoding="utf-8")
    for name in ("DOCS", "ROOT"):
        monkeypatch.setattr(build_readme, name, tmp_path)
    out = tmp_path / "out"
    assert build_readme.main(out) == 2
    (out / "instructions").mkdir(parents=True)
    (out / "readme_block.md").write_text("| state level |", encoding="utf-8")
    (out / "instructions" / "readme_block.md").write_text(TABLE, encoding="utf-8")
    for folder in ("figures", "tables"):
        (out / folder).mkdir()
    for name in ("figures/a.png", "tables/a.csv", "report.html", "study.md"):
        (out / name).write_text(name, encoding="utf-8")
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "old.png").touch()
    assert build_readme.main(out) == 0
    assert "27 of 156" in (tmp_path / "README.md").read_text(encoding="utf-8")
    assert "| state level |" in (tmp_path / "results.md").read_text(encoding="utf-8")
    copied = {str(path.relative_to(tmp_path / "results")) for path in (tmp_path / "results").rglob("*.*")}
    assert copied == {"figures/a.png", "tables/a.csv", "report.html", "study.md"}
    assert (tmp_path / "results" / "study.md").read_text(encoding="utf-8").endswith("do not edit. -->\n\nstudy.md")
