"""Write page and figure of the study from its stored rows; with --fly, fly the study first.

python -m studies.assumptions [--fly] [--out out/assumptions] [--workers 2]
"""

import argparse
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

from mavfi.cli.stopping import stoppable
from mavfi.config import parse, read_yaml
from mavfi.extras.paper.cli_report import StudyBar
from mavfi.files import check_folder, make_folder
from mavfi.report import style
from studies.assumptions.design import AssumptionStudy
from studies.assumptions.page import FIGURE, changes, figure_of, page
from studies.assumptions.rounds import fly_assumptions
from studies.assumptions.stored import FOLDER, stored_rows
from studies.assumptions.tables import tables
from tools.results import RESULTS

DEFINITION = Path(__file__).with_name("assumptions.yaml")
PAGE = "assumptions.md"


def load_study(path: Path = DEFINITION) -> AssumptionStudy:
    """Read the definition of the study.

    Raises:
        BadInputError: The file is invalid.
    """
    return parse(AssumptionStudy, read_yaml(path), str(path))


def fly_study(study: AssumptionStudy, out: Path, workers: int) -> Path:
    """Fly the study, or what is left of it, to a folder; returns the folder of its tables."""
    check_folder(out)
    stopped = f"Stopped. What is done is kept in {out}; the same command resumes."
    with stoppable(stopped), StudyBar(f"study {study.name}") as bar:
        results = fly_assumptions(study, out, workers, bar)
        folder = out / "tables"
        make_folder(folder)
        bar.begin_step("tables")
        for table in tables(results):
            table.write(folder)
    return folder


def main(arguments: Sequence[str]) -> int:
    """Write the page; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m studies.assumptions", description=__doc__.splitlines()[0])
    parser.add_argument("--fly", action="store_true", help="fly the study, or resume it: an hour of two processors")
    parser.add_argument("--out", type=Path, default=Path("out/assumptions"), help="folder of its ledgers and models")
    parser.add_argument("--workers", type=int, default=2, help="number of processes")
    options = parser.parse_args(arguments)
    if options.fly:
        flown = fly_study(load_study(), options.out, options.workers)
        shutil.rmtree(FOLDER, ignore_errors=True)
        shutil.copytree(flown, FOLDER)
    (RESULTS / PAGE).write_text(page(FOLDER, f"tables/{FOLDER.name}"), encoding="utf-8")
    with style.house_style():
        style.write(figure_of(changes(stored_rows("axes"), load_study().environments)), RESULTS / FIGURE)
    print(f"wrote {RESULTS / PAGE}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
