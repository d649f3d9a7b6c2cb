"""A private network for ROS programs: roscpp listens on all interfaces, whatever its settings."""

import subprocess

from mavfi.errors import BadInputError


def private_network(allowed: str = "as root, or with user namespaces") -> list[str]:
    """Command that runs a program in a network of its own, in which nothing outside can reach it.

    Raises:
        BadInputError: There can be none; the line says what is allowed instead.
    """
    for way in (["unshare", "-n"], ["unshare", "-Urn"]):
        try:
            if subprocess.run([*way, "true"], capture_output=True, check=False).returncode == 0:
                return way
        except OSError:
            break
    raise BadInputError(
        "no private network: neither `unshare -n` nor `unshare -Urn` works here, and ROS's C++ nodes listen on all "
        f"interfaces; allowed: {allowed}"
    )
