"""Things by name: shipped ones, entry points of other packages, and `package:object` of a user's own."""

import importlib
import sys
from collections.abc import Mapping
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from mavfi.errors import BadInputError, MavfiError


def known(group: str, shipped: Mapping[str, str]) -> dict[str, str]:
    """Every name of a group of entry points and its place, "module:object"; shipped names cannot be taken."""
    return {point.name: point.value for point in entry_points(group=group)} | dict(shipped)


def load_object(what: str, name: str, group: str, shipped: Mapping[str, str]) -> Any:  # noqa: ANN401 - a user's own
    """What a name stands for.

    Args:
        what: Kind of thing, for messages: "detector", "planner", "generator".
        name: A known name, or "package.module:object".
        group: Group of entry points.
        shipped: As of `known`.

    Raises:
        BadInputError: The name is not known, or what it names cannot be imported or called; the message says why.
    """
    # entry points cannot take these names, and to look for them takes milliseconds
    place = shipped.get(name, name if ":" in name else "")
    if not place:
        names = known(group, shipped)
        place = names.get(name, "")
    if not place:
        raise BadInputError(f"{what} {name!r}: not known; allowed: {', '.join(sorted(names))}, or package:object")
    module, _, attribute = place.partition(":")
    # A console script does not look into the working directory, where a user's own module usually is.
    if str(Path.cwd()) not in sys.path:
        sys.path.append(str(Path.cwd()))
    try:
        found = getattr(importlib.import_module(module), attribute)
    except MavfiError:
        raise
    except Exception as error:  # noqa: BLE001 - whatever a user's module raises while it is imported
        raise BadInputError(f"{what} {name!r}: cannot be imported ({reason(error)})") from None
    if not callable(found):
        raise BadInputError(f"{what} {name!r}: cannot be called; allowed: a class or a function")
    return found


def build(
    what: str, name: str, factory: Any, *arguments: object, needs: tuple[str, ...] = (), **options: object
) -> Any:  # noqa: ANN401
    """Call a user's own class or function; kind (`what`) and name are for messages.

    Raises:
        BadInputError: It raised, or the object lacks a method that it `needs`.
    """
    try:
        made = factory(*arguments, **options)
    except MavfiError:
        raise
    except Exception as error:  # noqa: BLE001 - whatever a user's constructor raises
        raise BadInputError(f"{what} {name!r}: cannot be built ({reason(error)})") from None
    lacking = [method for method in needs if not callable(getattr(made, method, None))]
    if lacking:
        raise BadInputError(f"{what} {name!r}: lacks {', '.join(lacking)}")
    return made


def reason(error: Exception) -> str:
    """What a user's code raised, on one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
