"""Injections leave nothing behind, and what looks for it sees it where something is left."""

import json
import os
import subprocess
import sys
from dataclasses import replace

import pytest

from benchmarks.many_injections import Look, children, leaks, look
from tests.core.architecture.source import ROOT

NOTHING = Look(0, 6, 0, 100_000, 3)


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


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"children": 1}, "1 children at injection 500"),
        ({"files": 7}, "open files: 6 before, 7 after"),
        ({"memory_kib": 103_000}, "memory: 100,000 KiB at injection 250, 103,000 KiB after"),
        ({"left_behind": 4}, "temporary files: 3 before, 4 after"),
    ],
)
def test_leaks_are_reported(change, message):
    seen = [NOTHING, replace(NOTHING, injections=250), replace(NOTHING, injections=500)]
    assert leaks(seen) == []
    assert leaks([*seen[:2], replace(seen[2], **change)]) == [message]


def test_zombies_and_open_files_are_seen():
    before = look(0)
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os._exit(0)
    os.waitid(os.P_PID, child, os.WEXITED | os.WNOWAIT)  # it has ended, and is not buried
    try:
        seen = look(1)
        assert (seen.children, seen.files) == (before.children + 1, before.files + 2)
    finally:
        os.waitpid(child, 0)
        os.close(reading)
        os.close(writing)
    assert children() == before.children
