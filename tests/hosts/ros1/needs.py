"""What tests on real ROS need; elsewhere they are skipped, saying why."""

import pytest

from mavfi.hosts.ros1 import finder

ABSENT = finder.missing()
ros = [
    pytest.mark.ros,
    pytest.mark.skipif(bool(ABSENT), reason=f"ROS is not installed ({', '.join(ABSENT[:1])} is missing): `make ros`"),
]


def generated(folder):
    """Message classes in a folder, importable from now on."""
    from mavfi.hosts.ros1.generate import generate

    finder.enable(folder)
    generate(folder)
