import pytest

from tools import build_readme
from tools.markers import DOCS, ROOT, block_of

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
| Autoencoder-based | here, node restarts | 98.7 [93.1, 99.8] 77/78 | 97.4 [91.1, 99.3] 76/78 |
|  | paper | 100.0 | 84.7 |

- smaller differences are not distinguished: farm 16 / 4; dense 16 / 9
"""


BLOCKS = {"published_table": TABLE.replace("here, node restarts", "here"), "instruction_table": TABLE}


def test_the_readme_says_what_the_results_say():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    blocks = build_readme.readme_blocks((DOCS / "results.md").read_text(encoding="utf-8"))
    blocks["recommended"] = build_readme.recommended_item(block_of(readme, "recovery"))
    assert {name: block_of(readme, name) for name in blocks} == blocks
    assert readme[: readme.index("What helps")].count("\n") < 25 and readme.count("\n") <= 120


def test_findings_name_what_was_not_confirmed():
    claims = [
        {"claim": "gaussian_recovers", "verdict": "undecided"},
        {"claim": "autoencoder_recovers", "verdict": "contradicted"},
    ]
    text = build_readme.findings(BLOCKS, claims)
    assert "26 of 26 missions succeed" in text and "loses 3 of 156 (1.9 %)" in text
    assert "27 of 156 (17.3 %) if a crashed program is not restarted" in text
    assert "of 2 of its findings, each tested on fresh flights, 0 confirmed, 1 contradicted, 1 undecided" in text
    assert "Gaussian detector has no clear effect" in text and "autoencoder loses more missions than it" in text
    with pytest.raises(ValueError, match="not a success table"):
        build_readme.findings({**BLOCKS, "published_table": ""}, claims)


def test_what_recommended_brings_back_is_summed_over_the_faults_that_count():
    value = "| a value | 132 | 76 (58 %) | 11 (8 %) | 132 (100 %) |"
    instruction = "| an instruction | 8 | 0 of 6 (0 %) | 0 (0 %) | 7 (88 %) |"
    text = build_readme.recommended_item(f"{value}\n{instruction}")
    assert "139 of 140 missions lost to 2 kinds of faults" in text
    assert "Gaussian detector 76 of 138, its autoencoder 11 of 140" in text
