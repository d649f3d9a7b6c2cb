import re
from dataclasses import fields

import pytest
import typer

from mavfi.cli.commands import app
from mavfi.faults.fault import find_level, level_names
from tools import build_commands
from tools import build_reference as reference


@pytest.mark.parametrize("level", level_names())
def test_every_attribute_of_a_fault_is_explained(level):
    items = [line for line in reference.fault_section(level, find_level(level).fault) if line.startswith("- `")]
    assert len(items) == len(fields(find_level(level).fault)) and all("): " in line for line in items)


def test_every_linked_model_has_a_section():
    for page in reference.pages().values():
        linked = {link.split(")")[0] for link in page.split("](#")[1:]}
        headings = {line[3:].lower() for line in page.splitlines() if line.startswith("## ")}
        assert linked <= headings


def test_every_parameter_of_every_command_is_on_its_page():
    page = build_commands.page()
    common, *sections = re.split(r"^#+ `mavfi (?=[^`]+`$)", page, flags=re.MULTILINE)
    text_by_command = {section.partition("`")[0]: section for section in sections}
    program = typer.main.get_command(app)
    for name, text in text_by_command.items():
        command = program
        for word in name.split():
            command = command.commands[word]
        for parameter in command.params:
            label = parameter.name.upper() if parameter.param_type_name == "argument" else parameter.opts[0]
            assert parameter.hidden or f"`{label}`" in text, f"{name}: {label}"
        # what is only named stands in the common part, or on the page of missions
        for line in re.findall(r"^- also (.*)$", text, re.MULTILINE):
            assert all(f"\n- {label}" in common for label in line.split(", ")), f"{name}: {line}"
