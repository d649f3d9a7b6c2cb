"""What `mavfi report` imports for a stored ledger: nothing that flies."""

import subprocess
import sys

import pytest

from tests.core.unit.report.conftest import flown  # noqa: F401

FLIES = ("mavfi.flight", "mavfi.sim", "mavfi.pipeline", "mavfi.kernels", "mavfi.ir", "mujoco", "numba", "llvmlite")
REPORT = """
import sys
from mavfi.cli import run
assert run({arguments}) == 0
print("loaded:", *(name for name in {flies} if name in sys.modules))
"""


@pytest.mark.slow
def test_tables_text_and_figures_import_nothing_that_flies(flown):  # noqa: F811 - a fixture
    code = REPORT.format(arguments=["report", str(flown), "--all"], flies=FLIES)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].split() == ["loaded:"]
