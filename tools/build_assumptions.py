"""Fly the study of assumptions to out/assumptions, or resume it, and copy its page, figure and tables to docs/results.

make results NAME=assumptions
"""

import shutil
import subprocess
import sys
from pathlib import Path

from mavfi.extras.paper.assumptions.command import FIGURE, MARKDOWN, TABLES_FOLDER
from tools.markers import ROOT, banner
from tools.results import RESULTS, TABLES

OUT = Path("out") / "assumptions"


def copy(out: Path) -> None:
    """Copy the results in a folder to docs/results, in the place of the former ones."""
    text = (out / MARKDOWN).read_text(encoding="utf-8")
    text = text.replace(f"({TABLES_FOLDER}/", f"({TABLES.name}/assumptions/")
    (RESULTS / MARKDOWN).write_text(banner("make results NAME=assumptions") + text, encoding="utf-8")
    shutil.copy(out / FIGURE, RESULTS / FIGURE)
    tables = TABLES / "assumptions"
    shutil.rmtree(tables, ignore_errors=True)
    shutil.copytree(out / TABLES_FOLDER, tables)


def main(out: Path) -> int:
    """Fly the study and copy its results; returns the exit code."""
    command = [sys.executable, "-m", "mavfi", "reproduce", "assumptions", "--out", str(out)]
    subprocess.run(command, cwd=ROOT, check=True)
    copy(ROOT / out)
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]) if len(sys.argv) > 1 else OUT))
