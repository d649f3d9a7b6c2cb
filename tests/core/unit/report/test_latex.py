from mavfi.analysis.table import Column, Table
from mavfi.report.latex import latex_table


def test_a_table_has_rules_groups_and_escaped_texts():
    columns = (Column("row", ""), Column("measure", ""), Column("rate", "share_%", "percent"))
    rows = [("a & b", "here", 0.5), ("a & b", "[paper]", None), ("c", "here", 1.0)]
    lines = latex_table(Table("one_name", "5 % – more", columns, rows, 2, ("a note",))).splitlines()
    start = lines.index(r"\begin{tabular}{llr}")
    assert lines[1:5] == [r"\begin{table}", r"\caption{5 \% -- more}", r"\label{tab:one-name}", r"\centering"]
    assert lines[start + 1 : lines.index(r"\end{tabular}")] == [
        r"\toprule",
        r" &  & share\_\% \\",
        r"\midrule",
        r"a \& b & here & 50.0 \% \\",
        r" & {[}paper] & --- \\",
        r"\addlinespace",
        r"c & here & 100.0 \% \\",
        r"\bottomrule",
    ]
    assert "a note" in lines
