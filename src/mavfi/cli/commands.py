"""The application with all commands, and its error handling; commands import heavy modules on demand."""

import ast
import functools
import inspect
import os
import sys
import traceback
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any, NamedTuple

import typer
from typer.completion import completion_init  # type: ignore[attr-defined]
from typer.core import TyperCommand, TyperGroup

from mavfi.cli import panels
from mavfi.cli.console import complain
from mavfi.cli.stopping import EXIT_STOPPED
from mavfi.dropped import COMMANDS, OPTIONS
from mavfi.errors import BadInputError, MavfiError, machine_failure, missing_package, not_known
from mavfi.plugins import allow_plugins, allow_typed, known, plugin_failure

_ALLOW_PLUGINS = "--allow-plugins"
_COMPLETE = "_MAVFI_COMPLETE"
"""Environment variable by which a shell's script asks for completions, instead of a command."""
_TRACEBACK = "MAVFI_TRACEBACK"
"""Environment variable: if set, a refusal is preceded by its traceback."""
EXIT_DONE = 0
EXIT_FAILURE = 1
EXIT_BAD_INPUT = 2
VERBS = {
    "fly": "mavfi.cli.fly:fly",
    "campaign": "mavfi.cli.campaign:app",
    "compare": "mavfi.cli.runs:compare",
    "report": "mavfi.cli.report:report",
    "runs": "mavfi.cli.runs:runs",
    "replay": "mavfi.cli.runs:replay",
    "explain": "mavfi.cli.runs:explain",
    "shrink": "mavfi.cli.runs:shrink",
    "train": "mavfi.cli.train:train",
    "states": "mavfi.cli.states:states",
    "docs": "mavfi.cli.docs:docs",
    "init": "mavfi.cli.init:init",
    "doctor": "mavfi.cli.doctor:doctor",
    "cache": "mavfi.cli.doctor:cache",
    "completion": "mavfi.cli.completion:completion",
}
"""Commands of the core: a function, or a Typer application with commands of its own."""


class _Commands(Mapping[str, Any]):
    """Commands by name, each imported and built at first use: all of them would take a second."""

    def __init__(self) -> None:
        extras = known("mavfi.commands", {})
        self.addresses = VERBS | {name: extras[name] for name in sorted(extras)}
        self._built: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        if name not in self._built:
            module, _, attribute = self.addresses[name].partition(":")
            command = getattr(import_module(module), attribute)
            parent = typer.Typer()
            if isinstance(command, typer.Typer):
                parent.add_typer(command, name=name)
            else:
                parent.command(name)(command)
            self._built[name] = typer.main.get_group(parent).commands[name]
            _prepare(self._built[name])
        return self._built[name]

    def __contains__(self, name: object) -> bool:
        return name in self.addresses

    def __iter__(self) -> Iterator[str]:
        return iter(self.addresses)

    def __len__(self) -> int:
        return len(self.addresses)


class _Application(TyperGroup):
    """`mavfi`, whose help lists commands without importing them."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.commands: Any = _Commands()

    def list_commands(self, ctx: Any) -> list[str]:
        if ctx.resilient_parsing:  # for a completion, which has no panels
            return list(self.commands)

        def rank(name: str) -> int:
            return panels.OF_COMMANDS.index(_help_in_source(self.commands.addresses[name]).panel)

        return sorted(self.commands, key=rank)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name not in self.commands:
            return None
        described = _help_in_source(self.commands.addresses[cmd_name])
        return TyperCommand(cmd_name, help=_paragraphs(described.text), rich_help_panel=described.panel)

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        name, _, rest = super().resolve_command(ctx, args)
        if name is None:
            return None, None, rest
        return name, self.commands[name], rest  # with its options, which `get_command` leaves out


class _Help(NamedTuple):
    """What `mavfi --help` says of a command.

    Attributes:
        text: Its help; "" = none was found.
        panel: The panel that it stands in.
    """

    text: str
    panel: str


@functools.cache
def _help_in_source(address: str) -> _Help:
    """Help of a command, read from the source of its module.

    It is that of the function, or of a Typer application: the docstring of its callback or the option `help`.
    """
    module, _, name = address.partition(":")
    package, *path = module.split(".")
    text = ""
    panel = panels.OTHERS
    try:
        root = Path(find_spec(package).origin).parent  # type: ignore[union-attr, arg-type]
        tree = ast.parse(root.joinpath(*path).with_suffix(".py").read_text("utf-8"))
    except (ImportError, AttributeError, OSError, SyntaxError):  # a broken plug-in is reported when it is called
        return _Help(text, panel)
    # the definition of that name, or the application assigned to it; the panel of the module's commands
    for node in tree.body:
        if isinstance(node, ast.FunctionDef):
            decorators = map(ast.unparse, node.decorator_list)
            if node.name == name or f"{name}.callback()" in decorators:
                text = ast.get_docstring(node) or text
        elif isinstance(node, ast.Assign):
            target = ast.unparse(node.targets[0])
            if target == name and isinstance(node.value, ast.Call):
                for option in node.value.keywords:
                    if option.arg == "help":
                        text = ast.literal_eval(option.value)
            elif target == "HELP_PANEL" and isinstance(node.value, ast.Constant):
                panel = str(node.value.value)
    if panel not in panels.OF_COMMANDS:
        panel = panels.OTHERS
    return _Help(text, panel)


app = typer.Typer(
    cls=_Application,
    help="Fault injection, anomaly detection and recovery for autonomous UAVs, measured on whole missions.\n\n"
    "Exit codes: 0 done (also if the mission failed), 2 bad input, 3 a refuted plan, 1 a failure of mavfi, "
    "130 stopped by Ctrl-C.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)


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
    arguments = _prepared(arguments)

    # every known kind of failure becomes a line and an exit code
    try:
        if _is_group(arguments):
            arguments = [*arguments, "--help"]
        code = _command().main(args=arguments, prog_name="mavfi", standalone_mode=False)
    except MavfiError as error:
        code = EXIT_FAILURE
        if isinstance(error, BadInputError) and not machine_failure(error):
            code = EXIT_BAD_INPUT
        return _refused(_as_typed(str(error), arguments), code)
    except typer.TyperException as error:  # missing argument, unknown option, invalid number
        return complain(_refused_words(error, arguments), EXIT_BAD_INPUT)
    except typer.Abort:
        return EXIT_STOPPED
    except (Exception, SystemExit) as error:
        if isinstance(error.__context__, BrokenPipeError):  # the reader of the output has ended, e.g. `| head`
            return EXIT_DONE
        # a full disk and the like, then what the user installed or not; all others are defects of mavfi
        if failure := machine_failure(error):
            return _refused(failure, EXIT_FAILURE)
        missing = None
        if isinstance(error, ModuleNotFoundError):
            missing = missing_package(error, f"mavfi {_verb(arguments)}".rstrip())
        if failure := str(missing or plugin_failure(error)):
            return _refused(failure, EXIT_BAD_INPUT)
        raise
    if isinstance(code, int):
        return code
    return EXIT_DONE


def _prepared(arguments: Sequence[str]) -> Sequence[str]:
    """Prepare for the words of a command: permission, completion, help; returns those that are left to parse."""
    # the permission comes first: commands of plug-ins are looked up already while the words are parsed
    if _ALLOW_PLUGINS in arguments:
        allow_plugins()
        arguments = [word for word in arguments if word != _ALLOW_PLUGINS]
    allow_typed(word.rpartition("=")[2] for word in arguments)

    if os.environ.get(_COMPLETE):
        completion_init()
        os.environ["COLUMNS"] = "1000"  # each completion is one line
    else:
        _import_help(arguments)
    return arguments


def _refused_words(error: typer.TyperException, arguments: Sequence[str]) -> str:
    """The message on words that are no command: what to do instead, or what is allowed and where to read on."""
    dropped = _dropped(arguments)
    if dropped:
        return dropped
    message = _unknown_word(error, arguments) or _refused_value(error) or error.format_message().rstrip(".")
    return f"{message}; see `mavfi {_verb(arguments)}--help`"


def _as_typed(text: str, arguments: Sequence[str]) -> str:
    """A message that begins with the name of a key, with that of its option instead if the option was typed."""
    key, colon, rest = text.partition(":")
    option = "--" + key.replace("_", "-")
    if colon and option in {word.partition("=")[0] for word in arguments}:
        return f"{option}:{rest}"
    return text


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


def _unknown_word(error: typer.TyperException, arguments: Sequence[str]) -> str:
    """The refusal of an option or command that does not exist, if that is the error; "" for others."""
    option = getattr(error, "option_name", "")
    if option and hasattr(error, "possibilities"):
        # Without the dashes, which all have in common.
        options = {name.lstrip("-"): name for name in (*(error.possibilities or ()), _ALLOW_PLUGINS)}
        likely = get_close_matches(option.lstrip("-"), list(options), 1, 0.6)
        question = ""
        if likely:
            question = f" (did you mean '{options[likely[0]]}'?)"
        return f"{option}: not known{question}"
    if not error.format_message().startswith("No such command"):
        return ""
    group = _command()
    for word in arguments:
        if word not in group.commands:
            return f"command {not_known(word, list(group.commands))}"
        group = group.commands[word]
    return ""


def _refused_value(error: typer.TyperException) -> str:
    """Option, value and what is allowed, if an error is that of a value of the wrong kind; "" for others."""
    from pydantic import ValidationError

    from mavfi.wording import allowed_by, shown

    cause = error.__cause__
    parameter = getattr(error, "param", None)
    if parameter is None or not isinstance(cause, ValidationError):
        return ""
    first = {**cause.errors()[0]}
    return f"{parameter.opts[0]}: {shown(first['input'])}: {allowed_by(first)}"


def _refused(text: str, code: int) -> int:
    """Write one line on the exception being handled, after its traceback if that is asked for; return the exit code."""
    if os.environ.get(_TRACEBACK):
        typer.echo(traceback.format_exc(), err=True, nl=False)
    return complain(text, code)


def _import_help(arguments: Sequence[str]) -> None:
    """If these words ask for help, import Typer's, without rich's Markdown and tracebacks: a fifth of its time."""
    if arguments and "--help" not in arguments:
        return
    stubs = {}
    for module, name in (("rich.markdown", "Markdown"), ("rich.traceback", "Traceback")):
        if module not in sys.modules:
            stubs[module] = ModuleType(module)
            setattr(stubs[module], name, _class_imported_later(module, name))
    sys.modules.update(stubs)
    try:
        import_module("typer.rich_utils")
    finally:
        for module in stubs:
            del sys.modules[module]


def _class_imported_later(module: str, name: str) -> type:
    """A class in the place of another, which is imported when an object is made, e.g. for the help of a plug-in."""

    def make(_: type, *arguments: Any, **named: Any) -> Any:
        return getattr(import_module(module), name)(*arguments, **named)

    return type(name, (), {"__new__": make})


@functools.cache
def _command() -> Any:
    """The application with all commands."""
    command = typer.main.get_command(app)
    for parameter in _with_help_option(command):
        _shorten_help(parameter)
    return command


def _prepare(command: Any) -> None:
    """Prepare a command, and those in its group: short help that fills any width, options are not given twice."""
    command.help = _paragraphs(command.help or "")
    parameters = _with_help_option(command)
    for parameter in parameters:
        _shorten_help(parameter)
    if any(parameter.rich_help_panel == panels.OUTPUT for parameter in parameters):
        parameters[-1].rich_help_panel = panels.OUTPUT  # otherwise a panel with --help alone would stand first
    members = getattr(command, "commands", {})
    for member in members.values():
        _prepare(member)
    if not members:
        command.parse_args = functools.partial(_parse_once, command)


def _with_help_option(command: Any) -> list[Any]:
    """The parameters of a command, and last the option `--help`."""
    return [*command.params, command.get_help_option(typer.Context(command))]


def _shorten_help(parameter: Any) -> None:
    """Leave out what says nothing: the type of flags; the default stands in the line of the help, not below it."""
    if parameter.param_type_name != "option":
        return
    if parameter.is_flag:
        parameter.metavar = ""
    elif parameter.show_default is True and parameter.default not in (None, ""):
        parameter.help += rf" [dim]\[{parameter.default}][/dim]"
        parameter.show_default = False


def _parse_once(command: Any, ctx: Any, args: list[str]) -> list[str]:
    """Parse the words of a command; an option of one value that is given twice is refused: one would be dropped."""
    if not ctx.resilient_parsing:  # as in completions
        _, _, order = command.make_parser(ctx).parse_args(args=list(args))
        for parameter, times in Counter(order).items():
            is_option = parameter.param_type_name == "option"
            if times > 1 and is_option and not parameter.multiple and not parameter.is_flag:
                raise BadInputError(f"{parameter.opts[0]}: given {times} times; allowed: once")
    words: list[str] = type(command).parse_args(command, ctx, args)
    return words


def _paragraphs(text: str) -> str:
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in inspect.cleandoc(text).split("\n\n"))


def _is_group(arguments: Sequence[str]) -> bool:
    """Whether words name a group of commands, and none of them."""
    command = _command()
    for word in arguments:
        command = getattr(command, "commands", {}).get(word)
    return hasattr(command, "commands")


def _verb(arguments: Sequence[str]) -> str:
    """The given command, with a group's own, followed by a space, for a hint; empty if there is no such command."""
    command = _command()
    words = []
    for word in arguments:
        if word not in getattr(command, "commands", {}):
            break
        command = command.commands[word]
        words.append(f"{word} ")
    return "".join(words)
