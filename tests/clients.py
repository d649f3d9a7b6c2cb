"""Other people's client programs, each in a Python environment of its own, which `make clients` makes."""

import os

from tests.core.architecture.source import ROOT


def python_of(name):
    """The Python with a client: `AIRSIM_PYTHON`, `MAVSDK_PYTHON`, else that of `make clients`; "" if there is none."""
    made = ROOT / "build" / "clients" / name / "bin" / "python"
    return os.environ.get(f"{name.upper()}_PYTHON", str(made) if made.exists() else "")
