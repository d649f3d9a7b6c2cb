"""Names of the ROS graph as users write them."""

from collections.abc import Collection
from difflib import get_close_matches

from mavfi.errors import BadInputError

_MOST_SHOWN = 12


def absolute(name: str) -> str:
    """The name with its leading slash."""
    return name if name.startswith("/") else f"/{name}"


def allowed(names: Collection[str], wanted: str = "") -> str:
    """The names that there are, for a message: the likeliest first, not more than a line holds."""
    likely = get_close_matches(wanted, names, 3, 0.5)
    ordered = [*likely, *sorted(set(names) - set(likely))]
    more = f", and {len(ordered) - _MOST_SHOWN} more" if len(ordered) > _MOST_SHOWN else ""
    return (", ".join(ordered[:_MOST_SHOWN]) + more) if ordered else "none, there are none"


def check_known(what: str, name: str, names: Collection[str]) -> str:
    """The absolute name, if it is known.

    Raises:
        BadInputError: It is not; the line says which are.
    """
    wanted = absolute(name)
    if wanted not in names:
        raise BadInputError(f"{what} {wanted}: not in the graph; allowed: {allowed(names, wanted)}")
    return wanted
