"""Put the table that a campaign printed between the markers of README.md.

    python docs/build_readme.py out/reproduce

The report writes `readme_block.md` and, if it drew one, `flight.png` into its folder; both are copied as they are, so
no figure in the README is ever typed.
"""

import shutil
import sys
from pathlib import Path

from build_pages import between

ROOT = Path(__file__).parents[1]


def main(out: Path) -> int:
    """Update README.md and its picture from a folder that a report was written to; returns the exit code."""
    block = out / "readme_block.md"
    if not block.is_file():
        print(f"{block}: not there; run `make reproduce` first", file=sys.stderr)
        return 2
    readme = ROOT / "README.md"
    page = between(readme.read_text(encoding="utf-8"), "table", block.read_text(encoding="utf-8"))
    readme.write_text(page, encoding="utf-8")
    picture = out / "flight.png"
    if picture.is_file():
        shutil.copyfile(picture, ROOT / "docs" / "images" / "flight.png")
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/reproduce")))
