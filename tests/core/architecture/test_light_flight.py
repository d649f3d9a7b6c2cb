"""What `mavfi fly` imports: nothing that analyses, since SciPy's statistics alone take longer than a short flight."""

import subprocess
import sys

HEAVY = (
    "dask",
    "jinja2",
    "matplotlib",
    "mavfi.analysis",
    "mavfi.campaign.config",
    "pandas",
    "polars",
    "rosbags",
    "scipy.linalg",
    "scipy.optimize",
    "scipy.spatial",
    "scipy.stats",
    "sklearn",
)
FLY = """
import sys
from mavfi.cli import run
assert run(["fly"]) == 0
print("loaded:", *(name for name in {heavy} if name in sys.modules))
"""


def test_a_flight_imports_nothing_that_analyses():
    # Once to compile, with whatever that needs; the second process finds the code in the cache.
    for _ in range(2):
        command = [sys.executable, "-c", FLY.format(heavy=HEAVY)]
        flown = subprocess.run(command, capture_output=True, text=True, check=False)
        assert flown.returncode == 0, flown.stderr
    assert flown.stdout.splitlines()[-1].split() == ["loaded:"]
