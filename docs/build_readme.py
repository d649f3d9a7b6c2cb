"""Put the tables that `mavfi reproduce` printed, of both levels, between the markers of README.md.

    python -m docs.build_readme out/reproduce

The reports write `readme_block.md` and, if they drew one, `flight.png` into their folders; the blocks, and the picture
of the state level, are copied as they are, so no figure in the README is ever typed.
"""

import shutil
import sys
from pathlib import Path

from docs.build_pages import between

ROOT = Path(__file__).parents[1]
BLOCKS = {"table": "readme_block.md", "instruction_table": "instructions/readme_block.md"}
"""Where the block comes from that goes between the markers of a name."""


def main(out: Path) -> int:
    """Update README.md and its picture from a folder that a report was written to; returns the exit code."""
    for block in BLOCKS.values():
        if not (out / block).is_file():
            print(f"{out / block}: not there; run `make reproduce` first", file=sys.stderr)
            return 2
    readme = ROOT / "README.md"
    page = readme.read_text(encoding="utf-8")
    for name, block in BLOCKS.items():
        page = between(page, name, (out / block).read_text(encoding="utf-8"))
    readme.write_text(page, encoding="utf-8")
    picture = out / "flight.png"
    if picture.is_file():
        shutil.copyfile(picture, ROOT / "docs" / "images" / "flight.png")
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/reproduce")))
