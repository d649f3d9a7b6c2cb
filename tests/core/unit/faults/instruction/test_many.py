"""Injections leave nothing behind, and what looks for it sees it where something is left."""

import json
import os
import subprocess
import sys

import pytest

from benchmarks.many_injections import Look, leaks
from tests.core.architecture.source import ROOT

MANY = """
import json
from dataclasses import asdict
from benchmarks.many_injections import inject_often
outcomes, seen = inject_often(80, looks=5)
print(json.dumps([outcomes, [asdict(one) for one in seen]]))
"""


@pytest.mark.slow
def test_many_injections_of_all_kinds_leave_nothing_behind(tmp_path):
    """In a process of its own: it is small, so that forks are fast."""
    environment = {**os.environ, "TMPDIR": str(tmp_path), "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
    done = subprocess.run([sys.executable, "-c", MANY], env=environment, capture_output=True, text=True, check=True)
    outcomes, looks = json.loads(done.stdout)
    seen = [Look(**one) for one in looks]
    assert sum(outcomes.values()) == seen[-1].injections == 80
    assert outcomes["crash"] > 0 and outcomes["sdc"] > 0 and outcomes["masked"] > 0
    assert len(seen) == 6
    assert leaks(seen) == []
