"""Pydantic's errors in mavfi's wording: one line that names key, value and what is allowed."""

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError

from mavfi.dropped import dropped_key
from mavfi.errors import hint

_ALLOWED = {
    "greater_than": "above {gt:g}",
    "greater_than_equal": "{ge:g} or more",
    "less_than": "below {lt:g}",
    "less_than_equal": "{le:g} or less",
    "multiple_of": "multiples of {multiple_of:g}",
    "finite_number": "a finite number",
    "float_type": "a number",
    "float_parsing": "a number",
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float", "int_parsing_size"), "a whole number"),
    **dict.fromkeys(("bool_type", "bool_parsing"), "true, false"),
    "string_type": "text",
    **dict.fromkeys(("dict_type", "model_type", "model_attributes_type", "mapping_type"), "keys with values"),
    **dict.fromkeys(("list_type", "tuple_type"), "a list"),
    "too_short": "a list of {min_length} or more",
    "too_long": "a list of {max_length} or fewer",
    "string_pattern_mismatch": "text of the form {pattern}",
}
"""What is allowed, by pydantic's type of error."""
_LONGEST = 60
"""Longest list that is shown (characters)."""
_KEY = "[key]"
"""Pydantic's mark of an error in the key of a mapping."""


def finding(error: ValidationError, model: type[BaseModel] | None = None, under: str = "") -> str:
    """The first of pydantic's errors: key, value and what is allowed; checks of a whole model name keys themselves.

    `under`: the key whose value is the model.
    """
    first = _first(error)
    owner = None
    location = first["loc"]
    if model is not None:
        owner, location = _locate(model, model, first["loc"])
    kind = first["type"]
    name = ""
    if location:
        name = str(location[-1])
    key = ".".join(filter(None, (under, *map(str, location))))
    value = first["input"]

    # checks of mavfi's own models say in their message what is allowed
    if kind == "value_error":
        message: str = first["msg"].removeprefix("Value error, ")
        if not key or message.startswith(f"{key}."):
            return message
        return f"key {key!r}: {message}"

    # what earlier versions accepted: the message says what replaces it
    if kind == "extra_forbidden" and dropped_key(name):
        return dropped_key(name)

    # keys that do not exist, or are absent
    if kind == "extra_forbidden" and owner is not None:
        known_keys = [*owner.model_fields, *getattr(owner, "also_accepts", ())]
        return f"unknown key {key!r}{hint(name, known_keys)}; allowed: {', '.join(known_keys)}"
    if kind == "missing":
        choices = ""
        if owner is not None and name in owner.model_fields:
            kind_of_value = owner.model_fields[name].annotation
            if get_origin(kind_of_value) is Literal:
                choices = f"; allowed: {', '.join(map(str, get_args(kind_of_value)))}"
        return f"key {key!r}: is required{choices}"

    # values that are not allowed
    if kind == "literal_error":
        expected = first["ctx"]["expected"]
        words = [word.strip("'") for word in expected.replace(" or ", ", ").split(", ")]
        return f"key {key!r}: {shown(value)}: not known{hint(value, words)}; allowed: {expected}"
    return f"key {key!r}: {shown(value)}: {allowed_by(first)}"


def _first(error: ValidationError) -> Mapping[str, Any]:
    """The error to report: a dropped key, or else the first one.

    Before an absent key comes an unknown one, which probably misspells it.
    """
    errors: list[Mapping[str, Any]] = [{**details} for details in error.errors()]
    for details in errors:
        is_unknown = details["type"] == "extra_forbidden"
        if is_unknown and (errors[0]["type"] == "missing" or dropped_key(str(details["loc"][-1]))):
            return details
    return errors[0]


def allowed_by(error: Mapping[str, Any]) -> str:
    """What one of pydantic's errors allows."""
    pattern = _ALLOWED.get(error["type"])
    if pattern is None:
        return str(error["msg"])
    return f"allowed: {pattern.format(**error.get('ctx', {}))}"


def shown(value: object) -> str:
    """A value as its file has it, or its kind if it is long."""
    if isinstance(value, dict):
        return "keys with values"
    if isinstance(value, (list, tuple)):
        text = f"[{', '.join(map(shown, value))}]"
        if len(text) <= _LONGEST:
            return text
        return "a list"
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value)


def refuse_other_kind(annotation: Any, value: object) -> None:  # noqa: ANN401
    """Raise a ValueError for true or false where a number is expected, and for anything else where they are."""
    kinds = _members(annotation)
    if isinstance(value, bool):
        if {int, float} & set(kinds) and bool not in kinds:
            number = "a whole number"
            if float in kinds:
                number = "a number"
            raise ValueError(f"{shown(value)}: allowed: {number}")
    elif bool in kinds and set(kinds) <= {bool, type(None)} and value is not None:
        raise ValueError(f"{shown(value)}: allowed: true, false")
    elif isinstance(value, dict):
        _refuse_elements([get_args(kind)[1:] for kind in kinds if get_origin(kind) is dict], value.values())
    elif isinstance(value, (list, tuple)):
        _refuse_elements([get_args(kind) for kind in kinds if get_origin(kind) in (list, tuple)], value)


def _refuse_elements(annotations: Sequence[tuple[Any, ...]], elements: Iterable[object]) -> None:
    """Apply `refuse_other_kind` to the elements of a list or mapping; models (no annotation) check their own."""
    element_kinds = tuple(kind for arguments in annotations for kind in arguments if kind is not ...)
    if not element_kinds:
        return
    for element in elements:
        refuse_other_kind(Union[element_kinds], element)  # noqa: UP007 - of any number


@cache
def _members(annotation: Any) -> tuple[Any, ...]:  # noqa: ANN401
    """The kinds of value that an annotation allows, without constraints."""
    if get_origin(annotation) is Annotated:
        return _members(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return tuple(kind for part in get_args(annotation) for kind in _members(part))
    return (annotation,)


def _locate(
    owner: type[BaseModel],
    annotation: Any,
    location: tuple[int | str, ...],  # noqa: ANN401
) -> tuple[type[BaseModel], tuple[int | str, ...]]:
    """The model in which a location's last key stands, and the location in the file: without marks of pydantic."""
    if not location or location[0] == _KEY:
        return owner, ()
    kinds = [kind for kind in _members(annotation) if kind is not type(None)]
    if len(kinds) != 1:  # pydantic names the member of the union
        return owner, ()
    kind = kinds[0]
    (first, *rest) = location
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        owner = kind
        field = kind.model_fields.get(str(first))
        annotation = None
        if field is not None:
            annotation = field.annotation
    elif get_origin(kind) in (dict, list, tuple):
        # the element's annotation; of a dictionary that of its values, which is the last one
        arguments = get_args(kind)
        position = -1
        if isinstance(first, int):
            position = min(first, len(arguments) - 1)
        annotation = arguments[position]
        if annotation is Ellipsis:  # tuple[X, ...]
            annotation = arguments[0]
    else:
        return owner, location
    if not rest:
        return owner, (first,)
    owner, inner = _locate(owner, annotation, tuple(rest))
    return owner, (first, *inner)
