"""AirSim's own client, which needs an environment of its own: msgpack-rpc-python wants an old tornado.

`make clients` makes it.
"""

import os

import pytest

from mavfi.extras.airsim.boundary import Boundary
from mavfi.extras.airsim.config import ProgramConfig
from mavfi.extras.airsim.host import run_program
from mavfi.mission import MissionSpec
from tests.core.architecture.source import ROOT
from tests.night import at_night

MADE = ROOT / "build" / "clients" / "airsim" / "bin" / "python"
PYTHON = os.environ.get("AIRSIM_PYTHON", str(MADE) if MADE.exists() else "")
pytestmark = pytest.mark.skipif(not PYTHON, reason="airsim 1.8.1 is not installed (make clients)")


@pytest.mark.parametrize("name", ["box", *at_night("orbit", "survey")])
def test_a_program_has_the_same_bytes_with_both_clients(name):
    pytest.importorskip("cosysairsim")
    script = str(ROOT / "examples" / "airsim" / f"{name}.py")
    ended = [
        run_program(
            ProgramConfig(script=script, python=python), MissionSpec(environment="sparse", seed=7), Boundary(keeps=True)
        )
        for python in ("", PYTHON)
    ]
    new, old = ended
    assert new.how == old.how == "ended" and sum(old.calls.values()) > 10
    assert old.digest == new.digest and old.calls == new.calls
    passed = [[(crossing.name, crossing.returned) for crossing in run.boundary.passed] for run in ended]
    assert passed[0] == passed[1]  # the arguments of simGetImages differ: only the new one names an annotation
