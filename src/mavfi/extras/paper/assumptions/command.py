"""`mavfi reproduce assumptions`: fly the study of assumptions, write its page and figure, print its answer."""

from pathlib import Path

from rich.text import Text

from mavfi.cli.console import console, write_json
from mavfi.cli.stopping import stoppable
from mavfi.config import config_root, parse, read_yaml
from mavfi.errors import BadInputError, not_known, write_text
from mavfi.extras.paper.assumptions.design import AssumptionStudy
from mavfi.files import check_folder, is_file, make_folder
from mavfi.report.text import show_table

MARKDOWN = "assumptions.md"
FIGURE = "assumptions.png"
TABLES_FOLDER = "tables"
_AXES = "axes"
"""Key that a study of campaigns does not have."""


def load_assumptions(name: str) -> AssumptionStudy | None:
    """A study of assumptions from a path, or a shipped one by name; None if the name is that of another study.

    Raises:
        BadInputError: The file is invalid.
    """
    path = Path(name)
    if not name.endswith((".yaml", ".yml")):
        path = config_root() / "studies" / f"{name}.yaml"
    if not is_file(path):
        return None
    data = read_yaml(path)
    if _AXES not in data:
        return None
    return parse(AssumptionStudy, data, str(path))


def reproduce_assumptions(study: AssumptionStudy, scale: str, out: Path, workers: int, *, as_json: bool) -> None:
    """Fly a study of assumptions, or what is left of it, and report it.

    Raises:
        BadInputError: It is asked for at another scale than quick, its only one.
    """
    from mavfi.extras.paper.assumptions.page import axes_figure, markdown, summary, tables
    from mavfi.extras.paper.assumptions.rounds import fly_assumptions
    from mavfi.extras.paper.cli_report import StudyBar
    from mavfi.extras.paper.steps import StepTimes
    from mavfi.report import style

    if scale != "quick":
        raise BadInputError(f"study {study.name}: scale {not_known(scale, ['quick'])}")
    check_folder(out)
    stopped = f"Stopped. What is done is kept in {out}; the same command resumes."
    with stoppable(stopped), StudyBar(f"study {study.name}", StepTimes.begin(out, workers)) as bar:
        results = fly_assumptions(study, out, workers, bar)
        with bar.timed("tables and figures"):
            shown = tables(results)
            write_text(out / MARKDOWN, markdown(results, shown, FIGURE, TABLES_FOLDER))
            make_folder(out / TABLES_FOLDER)
            for table in shown:
                write_text(out / TABLES_FOLDER / f"{table.name}.csv", table.to_csv())
            with style.house_style():
                style.write(axes_figure(results), out / FIGURE)
    if as_json:
        write_json([table.to_json() for table in shown])
        return
    terminal = console()
    for sentence in summary(results):
        terminal.print(Text(sentence))
    for table in shown[:2]:
        show_table(table, terminal)
    terminal.print(Text(f"All tables: {out / MARKDOWN}"))
