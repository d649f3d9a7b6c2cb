"""Draw the pictures of the pages from flights and kernel runs.

make results NAME=pictures
"""

import runpy
import subprocess
import sys

from tools.markers import ROOT

RESCUE = (
    "fly --environment dense --seed 10007 --fault state:perception.collision_status.collision --fault-seed 1 "
    "--detector recommended --picture docs/images/rescue.png"
)


def main() -> None:
    """Run each module that draws, then a command that draws the picture of README.md."""
    scripts = [f"examples.pictures.{path.stem}" for path in sorted((ROOT / "examples" / "pictures").glob("*.py"))]
    for script in scripts:
        print(script)
        runpy.run_module(script, run_name="__main__")
    subprocess.run([sys.executable, "-m", "mavfi", *RESCUE.split()], check=True)


if __name__ == "__main__":
    main()
