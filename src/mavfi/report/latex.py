"""Tables in LaTeX, with the rules of the package booktabs."""

from collections.abc import Sequence

from mavfi.analysis.table import TEXT, Table
from mavfi.report.text import grouped, shown

_ESCAPES = str.maketrans(
    {
        "\\": r"\textbackslash{}",
        "[": "{[}",  # at the start of a line it would be an option of the line break before
        "{": r"\{",
        "}": r"\}",
        "&": r"\&",
        "%": r"\%",
        "$": r"\$",
        "#": r"\#",
        "_": r"\_",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        # what the fonts of LaTeX have in mathematics only
        "−": "$-$",
        "×": r"$\times$",
        "→": r"$\rightarrow$",
        "≤": r"$\leq$",
        "≥": r"$\geq$",
        "²": r"\textsuperscript{2}",
        "·": r"$\cdot$",
        "—": "---",
        "–": "--",
    }
)


def latex_table(table: Table) -> str:
    """Format a table with its title as caption and its notes below, as a float.

    A first cell equal to the one above is left empty, and groups of them are set apart.
    """
    columns, rows = shown(table)
    alignment = ""
    for index, column in enumerate(columns):
        if index < table.keys or column.form == TEXT:
            alignment += "l"
        else:
            alignment += "r"
    # rows, in groups of equal first cells if there are any
    has_groups = len({row[0] for row in rows}) < len(rows)
    body = []
    for cells, begins_group in grouped(rows):
        if has_groups and begins_group:
            body.append(r"\addlinespace")
        body.append(_line(cells))
    lines = [
        r"% needs \usepackage{booktabs}",
        r"\begin{table}",
        rf"\caption{{{_escaped(table.title)}}}",
        rf"\label{{tab:{table.name.replace('_', '-')}}}",
        r"\centering",
        rf"\begin{{tabular}}{{{alignment}}}",
        r"\toprule",
        _line([column.heading for column in columns]),
        r"\midrule",
        *body,
        r"\bottomrule",
        r"\end{tabular}",
    ]
    if table.notes:
        lines += ["", r"\medskip\footnotesize", _escaped("; ".join(table.notes))]
    return "\n".join([*lines, r"\end{table}", ""])


def _line(cells: Sequence[str]) -> str:
    return " & ".join(map(_escaped, cells)) + r" \\"


def _escaped(text: str) -> str:
    return text.translate(_ESCAPES)
