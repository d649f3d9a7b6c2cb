"""What earlier versions had is refused in one line that names what replaced it."""

import pytest

from mavfi.cli import run
from mavfi.dropped import COMMANDS, NAMES, OPTIONS, dropped_name


@pytest.mark.parametrize("option", OPTIONS)
def test_a_dropped_option_is_refused_with_what_replaced_it(option, capsys):
    assert run([*option.split(" ")]) == 2
    assert capsys.readouterr().err == f"mavfi: {option.split(' ')[-1]}: dropped; {OPTIONS[option]}\n"


@pytest.mark.parametrize("command", COMMANDS)
def test_a_dropped_command_is_refused_with_what_replaced_it(command, capsys):
    assert run(command.split(" ")) == 2
    assert capsys.readouterr().err == f"mavfi: {command}: dropped; {COMMANDS[command]}\n"


@pytest.mark.parametrize(("kind", "name"), NAMES)
def test_a_dropped_name_is_refused_with_what_replaced_it(kind, name):
    assert dropped_name(kind, name).endswith(f" {name!r}: dropped; {NAMES[kind, name]}")
