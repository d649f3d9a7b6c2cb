import os
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[4]


@pytest.fixture(autouse=True)
def _nodes_find_the_tests(monkeypatch):
    """Nodes are processes of their own: they look for detectors and kernels of these tests where pytest does."""
    there = os.environ.get("PYTHONPATH")
    monkeypatch.setenv("PYTHONPATH", f"{ROOT}{os.pathsep}{there}" if there else str(ROOT))
