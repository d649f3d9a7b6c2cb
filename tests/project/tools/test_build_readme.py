import pytest

from tools import build_readme
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
        "One fault per mission; n = 13 to 78 per cell.",
    ]
    for other in ("", TABLE.replace("|  | paper | 99.3 | 83.0 |\n", "")):
        with pytest.raises(ValueError, match="not a success table"):
            build_readme.compact(other)


def test_the_headline_of_the_readme_is_that_of_the_results():
    results = (DOCS / "results.md").read_text(encoding="utf-8")
    blocks = [
        results.partition(f"<!-- {name}:begin -->")[2].partition(f"<!-- {name}:end -->")[0]
        for name in ("published_table", "instruction_table")
    ]
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert build_readme.headline(*blocks) in readme
