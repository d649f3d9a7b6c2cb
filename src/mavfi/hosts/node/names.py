"""Names of the ROS graph as users write them."""

from collections.abc import Collection

from mavfi.errors import BadInputError, allowed


def absolute(name: str) -> str:
    """The name with its leading slash."""
    return name if name.startswith("/") else f"/{name}"


def check_known(what: str, name: str, names: Collection[str]) -> str:
    """The absolute name, if it is known.

    Raises:
        BadInputError: It is not; the line says which are.
    """
    wanted = absolute(name)
    if wanted not in names:
        raise BadInputError(f"{what} {wanted}: not in the graph; allowed: {allowed(names, wanted)}")
    return wanted
