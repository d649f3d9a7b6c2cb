"""A private network for ROS programs: roscpp listens on all interfaces, whatever it is told."""

import subprocess

from mavfi.errors import BadInputError

WAYS = (("unshare", "-n"), ("unshare", "-Urn"))


def private_network() -> list[str]:
    """Command that runs a program in a network of its own, in which nothing outside can reach it.

    Raises:
        BadInputError: It cannot be had.
    """
    for way in WAYS:
        try:
            if subprocess.run([*way, "true"], capture_output=True, check=False).returncode == 0:
                return list(way)
        except OSError:
            break
    raise BadInputError(
        "no private network: neither `unshare -n` nor `unshare -Urn` works here, and ROS's C++ nodes listen on all "
        "interfaces; allowed: as root, or with user namespaces"
    )
