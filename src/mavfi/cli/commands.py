"""The application with all commands, and its error handling; commands import heavy modules on demand."""

import functools
import inspect
import os
import traceback
from collections.abc import Sequence
from typing import Annotated, Any

import typer
from pydantic import ValidationError

from mavfi.cli import campaign, explain, export, fly, replay, report, runs, shrink, states, train
from mavfi.cli.console import complain
from mavfi.cli.stopping import EXIT_STOPPED
from mavfi.dropped import COMMANDS, OPTIONS
from mavfi.errors import BadInputError, MavfiError, machine_failure
from mavfi.extras.airsim import cli as airsim
from mavfi.extras.bench import cli as bench
from mavfi.extras.firmware import cli as firmware
from mavfi.extras.hardening import cli as harden
from mavfi.extras.hardening.vulnerability import cli as vulnerability
from mavfi.extras.logs import cli as watch_logs
from mavfi.extras.mavlink import cli as mavlink
from mavfi.extras.paper import cli as reproduce
from mavfi.extras.paper import cli_failures as failures
from mavfi.extras.paper import cli_redundancy as redundancy
from mavfi.extras.registers import cli as inject
from mavfi.extras.ros import cli as ros
from mavfi.plugins import allow_plugins, allow_typed, plugin_failure
from mavfi.wording import allowed_by, shown

_ALLOW_PLUGINS = "--allow-plugins"
_TRACEBACK = "MAVFI_TRACEBACK"
"""Environment variable: if set, a refusal is preceded by its traceback."""
EXIT_DONE, EXIT_FAILURE, EXIT_BAD_INPUT = 0, 1, 2

app = typer.Typer(
    help="Fault injection, anomaly detection and recovery for autonomous UAVs, measured on whole missions.\n\n"
    "Exit codes: 0 done (also if the mission failed), 2 bad input, 3 a refuted plan, 1 a failure of mavfi, "
    "130 stopped by Ctrl-C.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
for verb in (
    fly.fly, export.export, inject.inject, states.states, train.train, report.report, runs.runs, replay.replay,
    explain.explain, shrink.shrink, failures.failures, vulnerability.vulnerability, redundancy.redundancy,
    reproduce.reproduce, harden.harden, watch_logs.watch,
):  # fmt: skip
    app.command(verb.__name__)(verb)
app.add_typer(campaign.app, name="campaign")
app.add_typer(bench.app, name="bench")
app.add_typer(mavlink.app, name="mavlink")
app.add_typer(ros.app, name="ros")
app.add_typer(airsim.app, name="airsim")
app.add_typer(firmware.app, name="firmware")


def _tell_version(wanted: bool) -> None:
    if wanted:
        from mavfi.version import __version__

        typer.echo(__version__)
        raise typer.Exit


@app.callback()
def _mavfi(
    version: Annotated[
        bool, typer.Option("--version", callback=_tell_version, is_eager=True, help="Print the version.")
    ] = False,
    allow_plugins: Annotated[bool, typer.Option(_ALLOW_PLUGINS, help="Run code and programs that files name.")] = False,
) -> None:
    pass


def run(arguments: Sequence[str]) -> int:
    """Run a command, given as the words after `mavfi` (none = help); returns its exit code.

    Bad input, known failures and exceptions of plug-ins print one line on stderr; those of mavfi itself are raised.
    """
    if _ALLOW_PLUGINS in arguments:
        allow_plugins()
        arguments = [word for word in arguments if word != _ALLOW_PLUGINS]
    allow_typed(word.rpartition("=")[2] for word in arguments)
    try:
        code = _command().main(args=arguments or ["--help"], prog_name="mavfi", standalone_mode=False)
    except MavfiError as error:
        is_input = isinstance(error, BadInputError) and not machine_failure(error)
        return _refused(str(error), EXIT_BAD_INPUT if is_input else EXIT_FAILURE)
    except typer.TyperException as error:  # missing argument, unknown option, invalid number
        dropped = _dropped(arguments)
        if dropped:
            return complain(dropped, EXIT_BAD_INPUT)
        message = _refused_value(error) or error.format_message().rstrip(".")
        return complain(f"{message}; see `mavfi {_verb(arguments)}--help`", EXIT_BAD_INPUT)
    except typer.Abort:
        return EXIT_STOPPED
    except (Exception, SystemExit) as error:
        failed, of_plugin = machine_failure(error), plugin_failure(error)
        if not failed and not of_plugin:
            raise
        return _refused(failed, EXIT_FAILURE) if failed else _refused(of_plugin, EXIT_BAD_INPUT)
    return code if isinstance(code, int) else EXIT_DONE


def _dropped(arguments: Sequence[str]) -> str:
    """The refusal of an option or command that earlier versions had; "" = there is none in these words."""
    line = " ".join(arguments)
    words = {word.partition("=")[0] for word in arguments}
    for name, replacement in OPTIONS.items():
        command, _, option = name.rpartition(" ")
        if option in words and line.startswith(command):
            return f"{option}: dropped; {replacement}"
    for command, replacement in COMMANDS.items():
        if line.startswith(command):
            return f"{command}: dropped; {replacement}"
    return ""


def _refused_value(error: typer.TyperException) -> str:
    """Option, value and what is allowed, if an error is that of a value of the wrong kind; "" for others."""
    cause, parameter = error.__cause__, getattr(error, "param", None)
    if parameter is None or not isinstance(cause, ValidationError):
        return ""
    first = {**cause.errors()[0]}
    return f"{parameter.opts[0]}: {shown(first['input'])}: {allowed_by(first)}"


def _refused(text: str, code: int) -> int:
    """Write one line on the exception being handled, after its traceback if that is asked for; return the exit code."""
    if os.environ.get(_TRACEBACK):
        typer.echo(traceback.format_exc(), err=True, nl=False)
    return complain(text, code)


@functools.cache
def _command() -> Any:
    """The application with all commands; building it takes as long as a short command."""
    found = typer.main.get_command(app)
    _unwrap(found)
    return found


def _unwrap(command: Any) -> None:
    """Make each paragraph of the help of a command, and of those in its group, one line, which fills any width."""
    paragraphs = inspect.cleandoc(command.help or "").split("\n\n")
    command.help = "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)
    for one in getattr(command, "commands", {}).values():
        _unwrap(one)


def _verb(arguments: Sequence[str]) -> str:
    """The given command, with a group's own, followed by a space, for a hint; empty if there is no such command."""
    found, words = _command(), []
    for word in arguments:
        if word not in getattr(found, "commands", {}):
            break
        found = found.commands[word]
        words.append(f"{word} ")
    return "".join(words)
