from dataclasses import fields
from typing import Literal

import pytest
from pydantic import Field

from mavfi.config import Config
from mavfi.faults.fault import find_level, level_names
from tools import build_reference as reference


class Part(Config):
    """A part."""

    size: int = Field(3, ge=1, le=9, description="of it")


class Whole(Config):
    """A whole | with a bar."""

    part: Part
    names: tuple[str, ...] = ("a", "b")
    mode: Literal["x", "y"] = "x"


def test_a_model_becomes_a_table():
    assert "| `size` | integer | `3` | of it; ≥ 1, ≤ 9 |" in reference.model_section(Part)
    lines = reference.model_section(Whole)
    assert lines[:3] == ["## Whole", "", "A whole | with a bar."]
    assert "| `part` | [Part](#part) | required |  |" in lines and "| `names` | list of text | `[a, b]` |  |" in lines


@pytest.mark.parametrize("level", level_names())
def test_every_attribute_of_a_fault_is_explained(level):
    rows = [line for line in reference.fault_section(level, find_level(level).fault) if line.startswith("| `")]
    assert len(rows) == len(fields(find_level(level).fault)) and not any(line.endswith("|  |") for line in rows)


def test_every_linked_model_has_a_section():
    for page in reference.pages().values():
        linked = {link.split(")")[0] for link in page.split("](#")[1:]}
        headings = {line[3:].lower() for line in page.splitlines() if line.startswith("## ")}
        assert linked <= headings
