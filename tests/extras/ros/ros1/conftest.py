import os
import warnings
from pathlib import Path

import pytest

from tests.extras.ros.ros1.needs import ABSENT, generated

ROOT = Path(__file__).parents[4]


@pytest.fixture(autouse=True)
def _nodes_find_the_tests(monkeypatch):
    """Nodes are processes of their own: they look for detectors and kernels of these tests where pytest does."""
    there = os.environ.get("PYTHONPATH")
    monkeypatch.setenv("PYTHONPATH", f"{ROOT}{os.pathsep}{there}" if there else str(ROOT))


@pytest.fixture(scope="session")
def messages(tmp_path_factory):
    """Generated classes; ROS's own modules may warn."""
    if ABSENT:
        pytest.skip("ROS is not installed")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        generated(tmp_path_factory.mktemp("messages"))
        from mavfi.extras.ros.ros1.messages import state_types

        return state_types()
