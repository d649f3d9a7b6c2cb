"""The table of both levels: its intervals, its rows, and what it refuses."""

from collections import Counter

import pytest

from benchmarks import machine_level
from benchmarks.machine_level import PAGE, PROTECTED, Study, difference, main, table, wanted_faults
from mavfi.analysis.statistics import wilson
from mavfi.errors import BadInputError
from tools.markers import between

STUDY = Study(
    "pid",
    "track",
    {
        "machine": Counter(masked=30, sdc=56, crash=14),
        "IR": Counter(masked=50, sdc=50),
        PROTECTED: Counter(sdc=2, detected=98),
    },
    190,
    196,
    148,
    6,
    351,
)


def test_differences_have_newcombes_interval():
    """Newcombe 1998, table II, contrast (a), method 10."""
    found = difference(wilson(56, 70), wilson(48, 80))
    assert found == pytest.approx((0.2, 0.0524, 0.3339), abs=5e-5)


def test_the_table_has_both_levels_protected_code_and_their_differences():
    block = table([STUDY])
    rows = [row.split(" | ") for row in block.splitlines() if row.startswith("| pid")]
    assert [row[1] for row in rows] == ["machine", "IR", PROTECTED, "IR − machine", "protected − machine"]
    assert [row[4].split()[0] for row in rows[:3]] == ["56.0", "50.0", "2.0"]
    assert rows[3][3].startswith("-6.0 [") and rows[4][3].startswith("-54.0 [")
    assert "148 of them" in block and "351 injectable in protected code" in block
    assert between(PAGE.read_text(encoding="utf-8"), "machine-level", block).count(block) == 1


@pytest.mark.parametrize("text", ["0", "-3", "many", "2.5"])
def test_a_number_of_faults_that_is_none_is_refused(text, monkeypatch, capsys):
    with pytest.raises(BadInputError, match="allowed: a whole number, 1 or more"):
        wanted_faults(text)
    monkeypatch.setenv("N", text)
    monkeypatch.setattr(machine_level, "recorded", lambda: pytest.fail("it was not refused at once"))
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert capsys.readouterr().err == f"N: {text!r}: allowed: a whole number, 1 or more\n"
