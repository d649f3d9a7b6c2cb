"""Build the source distribution and from it the wheel; install it in empty environments of several Pythons; use it.

    python -m tools.check_release [python3.11 python3.12 ...]

Each environment is outside of the checkout, with a cache of its own: first the core alone, then with the extra `all`.
Prints the time and size of each installation, and writes them to docs/reference/installation.md with --write.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from mavfi.errors import MavfiError
from tools.markers import DOCS, ROOT, fill

CORE_COMMANDS = (
    "--version",
    "states",
    "doctor",
    "fly --seed 7 --fault state:planning.waypoint.x:bit=62@10 --detector recommended",
    "fly --seed 7 --fault instruction:pid --fault-seed 2",
    "campaign run smoke --out smoke --workers 1",
    "campaign digest smoke",
)
"""What the core does without any extra."""
COMMANDS = (
    "runs smoke",
    "report smoke --html report.html",
    "explain smoke 13",
    "campaign verify smoke",
    "fly --seed 7 --html flight.html --picture flight.png",
    "export smoke 13 --to flight.mcap",
    "train --flights 1 --out models",
    "docs --path",
)
"""What the extra `all` adds."""
WRITTEN = ("report.html", "flight.html", "flight.png", "flight.mcap", "models")
MOST_SECONDS = 60
MOST_MEGABYTES = 450


class Installation(NamedTuple):
    """One installation of the wheel.

    Attributes:
        python: Version of Python.
        extra: "" = the core alone.
        seconds: Time of `pip install` into the empty environment, or into the one with the core (s).
        megabytes: Size of all packages, without pip (MB).
    """

    python: str
    extra: str
    seconds: float
    megabytes: float


def build(folder: Path) -> Path:
    """Build both distributions into a folder; returns the wheel, which is made from the source distribution."""
    subprocess.run(
        [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder), str(ROOT)],
        check=True,
        stdout=subprocess.DEVNULL,
    )
    (wheel,) = folder.glob("*.whl")
    return wheel


def check(python: str, wheel: Path, folder: Path) -> list[Installation]:
    """Install a wheel in an empty environment and run its commands there.

    Raises:
        MavfiError: A command failed, or an installation is larger or slower than it may be.
    """
    # an environment that sees neither the checkout nor the caches of this user
    environment = folder / "venv"
    subprocess.run([python, "-m", "venv", str(environment)], check=True)
    variables = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "MAVFI"))}
    variables |= {"HOME": str(folder), "XDG_CACHE_HOME": str(folder / "cache"), "MPLBACKEND": "Agg"}
    program = environment / "bin" / "python"
    version = subprocess.run([program, "-V"], check=True, capture_output=True, text=True).stdout.split()[1]
    pip_megabytes = megabytes_of(environment)

    # the core alone, then everything
    installations = []
    for extra, commands in (("", CORE_COMMANDS), ("all", COMMANDS)):
        wanted = str(wheel)
        if extra:
            wanted = f"{wheel}[{extra}]"
        begun = time.monotonic()
        constraint = ["--constraint", str(ROOT / "requirements.lock")]
        subprocess.run([program, "-m", "pip", "install", "-qq", *constraint, wanted], check=True, env=variables)
        seconds = time.monotonic() - begun
        installations.append(Installation(version, extra, seconds, megabytes_of(environment) - pip_megabytes))
        for command in commands:
            run(environment / "bin" / "mavfi", command, folder, variables)
    missing = [name for name in WRITTEN if not (folder / name).exists()]
    if missing:
        raise MavfiError(f"Python {version}: {', '.join(missing)}: not written")
    core = installations[0]
    if core.seconds > MOST_SECONDS or core.megabytes > MOST_MEGABYTES:
        raise MavfiError(
            f"Python {version}: the core took {core.seconds:.0f} s and {core.megabytes:.0f} MB; allowed: "
            f"{MOST_SECONDS} s and {MOST_MEGABYTES} MB"
        )
    return installations


def run(program: Path, command: str, folder: Path, variables: dict[str, str]) -> None:
    """Run a command of the installed program; raises a `MavfiError` with its output if it fails."""
    done = subprocess.run(
        [program, *command.split()], cwd=folder, env=variables, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise MavfiError(f"mavfi {command}: exit code {done.returncode}\n{done.stdout[-2000:]}{done.stderr[-2000:]}")


def megabytes_of(folder: Path) -> float:
    """Size of the files in a folder (MB, 10^6 bytes)."""
    sizes = (path.lstat().st_size for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
    return sum(sizes) / 1e6


def table(installations: Sequence[Installation]) -> str:
    """The table of installations."""
    rows = ["| Python | installed | pip install, s | MB |", "|---|---|---:|---:|"]
    for each in installations:
        label = "core"
        if each.extra:
            label = f"`{each.extra}`, after the core"
        rows.append(f"| {each.python} | {label} | {each.seconds:.0f} | {each.megabytes:.0f} |")
    return "\n".join(rows)


def main() -> None:
    """Build, install and check; print the table, and write it if asked to."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pythons", nargs="*", default=[sys.executable], help="programs, this one by default")
    parser.add_argument("--write", action="store_true", help="put the table into docs/reference/installation.md")
    options = parser.parse_args()

    distributions = ROOT / "dist"
    shutil.rmtree(distributions, ignore_errors=True)
    wheel = build(distributions)
    installations: list[Installation] = []
    for python in options.pythons:
        print(f"{wheel.name} on {python} ...", flush=True)
        with tempfile.TemporaryDirectory() as folder:
            installations += check(python, wheel, Path(folder))
    text = table(installations)
    print(text)
    if options.write:
        fill(DOCS / "reference" / "installation.md", {"installations": text})


if __name__ == "__main__":
    main()
