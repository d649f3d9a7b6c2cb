"""AirSim's own client, which needs an environment of its own: msgpack-rpc-python wants an old tornado.

`make airsim-old` makes it and runs these tests.
"""

import os

import pytest

from mavfi.bridges.airsim.boundary import Boundary
from mavfi.bridges.airsim.config import ProgramConfig
from mavfi.bridges.airsim.program import run_program
from mavfi.mission import MissionSpec
from tests.architecture.source import ROOT

PYTHON = os.environ.get("AIRSIM_PYTHON", "")
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(not PYTHON, reason="AIRSIM_PYTHON: no interpreter with airsim 1.8.1 is named"),
]


@pytest.mark.parametrize("name", ["box", "orbit", "survey"])
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
    passed = [[(one.name, one.returned) for one in run.boundary.passed] for run in ended]
    assert passed[0] == passed[1]  # the arguments of simGetImages differ: only the new one names an annotation
