"""The worth of each rule alone is that of the ledgers; bad input is one line."""

from mavfi.errors import BadInputError
from mavfi.extras.bench.bench import load_bench
from studies.five_rules import __main__ as five_rules
from studies.five_rules.__main__ import ALL, SINGLE, main


def test_the_shipped_bench_flies_each_rule_and_all():
    assert list(load_bench("five-rules").arms) == [*SINGLE, ALL]


def test_bad_input_is_one_line(monkeypatch, capsys, tmp_path):
    def absent(folder):
        raise BadInputError(f"{folder}: no ledger")

    monkeypatch.setattr(five_rules, "load", absent)
    assert main([str(tmp_path)]) == 2
    message = capsys.readouterr().err
    assert message.startswith("bad input: ") and message.count("\n") == 1
