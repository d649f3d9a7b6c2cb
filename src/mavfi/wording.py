"""Pydantic's errors in mavfi's wording: one line that names key, value and what is allowed."""

from collections.abc import Mapping
from functools import cache
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError

from mavfi.dropped import dropped_key, dropped_value
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
    found: list[Mapping[str, Any]] = [{**one} for one in error.errors()]
    mistyped = [one for one in found if one["type"] == "extra_forbidden" and found[0]["type"] == "missing"]
    first = (mistyped or found)[0]
    if model is None:
        owner = None
        location = first["loc"]
    else:
        owner, location = _place(model, model, first["loc"])
    kind = first["type"]
    name = str(location[-1]) if location else ""
    key = ".".join(filter(None, (under, *map(str, location))))
    message: str = first["msg"].removeprefix("Value error, ")
    if kind == "value_error":
        if not key or message.startswith(f"{key}."):
            return message
        return f"key {key!r}: {message}"
    if kind == "extra_forbidden" and dropped_key(name):
        return dropped_key(name)
    if kind == "literal_error" and dropped_value(name, first["input"]):
        return dropped_value(name, first["input"])
    if kind == "extra_forbidden" and owner is not None:
        known = [*owner.model_fields, *getattr(owner, "also_accepts", ())]
        return f"unknown key {key!r}{hint(name, known)}; allowed: {', '.join(known)}"
    if kind == "missing":
        field = None if owner is None else owner.model_fields.get(name)
        if field is not None and get_origin(field.annotation) is Literal:
            allowed = get_args(field.annotation)
        else:
            allowed = ()
        return f"key {key!r}: is required" + (f"; allowed: {', '.join(map(str, allowed))}" if allowed else "")
    value = first["input"]
    context = first.get("ctx", {})
    if kind == "literal_error":
        words = [word.strip("'") for word in context["expected"].replace(" or ", ", ").split(", ")]
        return f"key {key!r}: {shown(value)}: not known{hint(value, words)}; allowed: {context['expected']}"
    return f"key {key!r}: {shown(value)}: {allowed_by(first)}"


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
            raise ValueError(f"{shown(value)}: allowed: {'a number' if float in kinds else 'a whole number'}")
    elif bool in kinds and set(kinds) <= {bool, type(None)} and value is not None:
        raise ValueError(f"{shown(value)}: allowed: true, false")
    elif isinstance(value, (list, tuple, dict)):
        origins = (dict,) if isinstance(value, dict) else (list, tuple)
        inner = tuple(get_args(kind) for kind in kinds if get_origin(kind) in origins)
        parts = tuple(part for one in inner for part in (one[1:] if origins == (dict,) else one) if part is not ...)
        elements = value.values() if isinstance(value, dict) else value
        for element in elements if parts else ():  # models check their own values
            refuse_other_kind(Union[parts], element)  # noqa: UP007 - of any number


@cache
def _members(annotation: Any) -> tuple[Any, ...]:  # noqa: ANN401
    """The kinds of value that an annotation allows, without constraints."""
    if get_origin(annotation) is Annotated:
        return _members(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return tuple(kind for part in get_args(annotation) for kind in _members(part))
    return (annotation,)


def _place(
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
        field = kind.model_fields.get(str(first))
        owner = kind
        annotation = None if field is None else field.annotation
    elif get_origin(kind) in (dict, list, tuple):
        annotation = get_args(kind)[min(int(first), len(get_args(kind)) - 1) if isinstance(first, int) else -1]
        if annotation is Ellipsis:
            annotation = get_args(kind)[0]
        else:
            annotation = annotation
    else:
        return owner, location
    if not rest:
        return owner, (first,)
    owner, inner = _place(owner, annotation, tuple(rest))
    return owner, (first, *inner)
