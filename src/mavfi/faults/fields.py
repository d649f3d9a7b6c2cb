"""States by name, and their numbers by path, e.g. `vx` or `x[3]`."""

import re

from mavfi.errors import BadInputError
from mavfi.states import STATES, State, StateSpec, states_with, unknown


def find_field(spec: StateSpec, path: str) -> str:
    """The name of a field in a path such as `vx` or `x[3]`; a BadInputError if the state has none of this name."""
    name, bracket, element = path.partition("[")
    spec.find(name)
    if bracket and not (spec.in_elements(name) and re.fullmatch(r"\d+\]", element)):
        raise BadInputError(f"state {spec.name}: {path!r}: allowed: {name}, or of lists {name}[NUMBER]")
    return name


def number_in(state: State, path: str) -> float:
    """The number at a path such as `vx` or `x[3]` (`x`: that of the first element); NaN if there is no such element."""
    name = find_field(state.spec, path)
    container = state.header
    row = 0
    if state.spec.in_elements(name):
        container = state.elements
        row = int(path[len(name) :].strip("[]") or 0)
    if row >= len(container):
        return float("nan")
    return float(container[name][row])


def find_published(name: str, localization: str) -> StateSpec:
    """A state that is published with this localization, or a BadInputError."""
    published = states_with(localization)
    if name not in STATES:
        raise BadInputError(unknown("state", name, published))
    if name not in published:
        only = STATES[name].only_with
        raise BadInputError(f"{name} is published with localization {only} only, not {localization}")
    return published[name]
