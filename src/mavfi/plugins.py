"""Objects by name: shipped ones, entry points of other packages, and a user's own `package:object`.

Code is run only at the user's request: by installing a package with entry points, by typing `package:object` or
passing it to the Python API, or by allowing all plug-ins.  A name in a file from another source is not sufficient.
"""

import functools
import hashlib
import importlib
import inspect
import json
import os
import pickle
import re
import stat
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.machinery import PathFinder
from importlib.metadata import entry_points
from pathlib import Path
from traceback import walk_tb
from typing import Any, NamedTuple

from mavfi.dropped import dropped_name
from mavfi.errors import BadInputError, MavfiError, hint, machine_failure, missing_package, not_known
from mavfi.output import divert_prints

_VARIABLE = "MAVFI_ALLOW_PLUGINS"
"""Allowed names, separated by spaces; an environment variable, inherited by child processes."""
_ALL = "all"
"""Word that allows every plug-in."""
_ADDRESS = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")
"""The form "package.module:object"."""
_CODE_FILES = (".xacro",)
"""Extensions of files that are not only data: xacro evaluates their expressions in Python."""
_OWN = __name__.partition(".")[0]
"""The package of mavfi itself."""


@dataclass
class _RememberedNames:
    """Names that the user has allowed in the ledgers that this process has opened.

    Attributes:
        unchanged: Allowed in this process, too; no reason to remember them for other ledgers.
        changed: They have another source now.
        absent: Their module is not found from this folder: the file that it had, by name.
    """

    unchanged: set[str] = field(default_factory=set)
    changed: set[str] = field(default_factory=set)
    absent: dict[str, str] = field(default_factory=dict)


_remembered_names = _RememberedNames()
_loaded: dict[str, dict[str, Any]] = {}
"""Plug-ins loaded in this process: by top-level package or module, the objects by the name that was requested."""


class NotAllowedError(BadInputError):
    """Code or a program that a file names was neither typed nor allowed."""


def allow_plugins() -> None:
    """Run code and programs named in files (configurations, ledgers), in this process and its children."""
    _allow([_ALL])


def allowed_names() -> list[str]:
    """Names allowed here, for worker processes on other machines."""
    return os.environ.get(_VARIABLE, "").split()


def allow_names(names: Iterable[str]) -> None:
    """Allow the names allowed in the process for which this one works."""
    _allow(names)


def allow_typed(words: Iterable[object]) -> None:
    """Allow the plug-ins among the words of a command or the arguments of a call, since the user typed them."""
    texts = [word for word in words if isinstance(word, str)]
    _allow(word for word in texts if _ADDRESS.fullmatch(word))
    _allow(str(Path(word)) for word in texts if word.endswith(_CODE_FILES))


def _allow(names: Iterable[str]) -> None:
    """Add names to those that are allowed, here and in child processes."""
    os.environ[_VARIABLE] = " ".join(dict.fromkeys([*allowed_names(), *names]))


def _is_allowed(name: str) -> bool:
    """Whether code or a program was typed or allowed."""
    return bool({_ALL, name} & set(allowed_names()))


def require_allowed(what: str, name: str) -> None:
    """Raise a `NotAllowedError` if code or a program was neither typed nor allowed."""
    if _is_allowed(name):
        return
    why = "named in a file, and so not run"
    if name in _remembered_names.absent:
        file = _remembered_names.absent[name]
        why = f"allowed for this ledger, but no longer imported from here; it was in {file}"
        raise NotAllowedError(f"{what} {name!r}: {why}; allowed: from the folder of that file")
    if name in _remembered_names.changed:
        why = "its source has changed since you allowed it for this ledger"
    raise NotAllowedError(
        f"{what} {name!r}: {why}; allowed: entry points of installed packages, or any with --allow-plugins"
    )


def known(group: str, shipped: Mapping[str, str]) -> dict[str, str]:
    """Every name of a group of entry points with its location, "module:object"; shipped names take precedence."""
    return {point.name: point.value for point in entry_points(group=group)} | dict(shipped)


@functools.cache
def extensions(group: str) -> dict[str, Any]:
    """What extras and other packages add to a group of entry points, imported: objects by name, in order of names.

    Raises:
        BadInputError: One cannot be imported.
    """
    loaded = {}
    for point in sorted(entry_points(group=group), key=lambda point: point.name):
        if _package(point.module) != _OWN:
            divert_prints()
        try:
            loaded[point.name] = point.load()
        except Exception as error:  # noqa: BLE001 - whatever another package raises while it is imported
            missing = None
            if isinstance(error, ModuleNotFoundError):
                missing = missing_package(error, f"{point.name} ({group})")
            raise missing or BadInputError(
                f"entry point {point.name!r} of {group}: {point.value} cannot be imported ({reason(error)}); allowed: "
                "without the package that brings it"
            ) from None
    return loaded


@dataclass(frozen=True)
class Chapter:
    """Views, or drawings, that stand together in reports; an entry point of a `Catalogue`.

    Attributes:
        rank: Chapters stand in the order of their ranks.
        members: What it holds, each with a `name`.
    """

    rank: int
    members: Sequence[Any]


class Catalogue(Mapping[str, Any]):
    """The members of all chapters in a group of entry points, by name and in order; imported at first use."""

    def __init__(self, group: str) -> None:
        self._group = group

    @functools.cached_property
    def _members(self) -> dict[str, Any]:
        chapters = sorted(extensions(self._group).values(), key=lambda chapter: chapter.rank)
        return {member.name: member for chapter in chapters for member in chapter.members}

    def __getitem__(self, name: str) -> Any:
        return self._members[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._members)

    def __len__(self) -> int:
        return len(self._members)


def load_object(  # noqa: ANN401 - a user's own
    what: str, name: str, group: str, shipped: Mapping[str, str], also: str = "or package:Class"
) -> Any:
    """The object that a name refers to.

    Args:
        what: Kind of object, for messages: "detector", "planner", "generator".
        name: A known name, or "package.module:object".
        group: Group of entry points.
        shipped: As for `known`.
        also: What else is allowed where the name is typed, for messages.

    Raises:
        BadInputError: Unknown name, not allowed (`allow_plugins`), or the object cannot be imported or called; the
            message says why.
    """
    # Shipped names and addresses first: entry points cannot take these, and searching them takes milliseconds.
    if name in shipped:
        address = shipped[name]
    elif _ADDRESS.fullmatch(name):
        address = name
        # Code is run only if the user has typed or allowed it.
        require_allowed(what, name)
        # A console script does not search the working directory, where a user's own module usually is.
        if str(Path.cwd()) not in sys.path:
            sys.path.append(str(Path.cwd()))
    else:
        names = known(group, shipped)
        if name not in names:
            unknown = f"{what} {not_known(name, sorted(names), also)}{without_class(name)}"
            raise BadInputError(dropped_name(f"{what}s", name) or unknown)
        address = names[name]
    module, _, attribute = address.partition(":")
    if _package(module) != _OWN:
        divert_prints()
    try:
        imported = importlib.import_module(module)
        loaded = getattr(imported, attribute, None)
    except MavfiError:
        raise
    except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever a user's module raises while it is imported
        missing = None
        if isinstance(error, ModuleNotFoundError):
            missing = missing_package(error, f"{what} {name!r}")
        raise missing or BadInputError(f"{what} {name!r}: cannot be imported ({reason(error)})") from None
    if loaded is None:
        question = hint(attribute, vars(imported))
        raise BadInputError(f"{what} {name!r}: cannot be imported ({module} has no {attribute}){question}")
    if not callable(loaded):
        raise BadInputError(f"{what} {name!r}: cannot be called; allowed: a class or a function")
    if _package(module) != _OWN:
        _loaded.setdefault(_package(module), {})[name] = loaded
    return loaded


def without_class(name: str) -> str:
    """What the refusal of a name adds if it is a module of this folder, without its class; "" = it is none."""
    if name.isidentifier() and Path(f"{name}.py").is_file():
        return f"; {name}.py is used as {name}:Class, with the name of its class"
    return ""


def parameters_of(what: str, name: str, factory: Any) -> list[str]:  # noqa: ANN401 - a user's own
    """Names of the parameters of a user's own class or function; kind (`what`) and name are for messages.

    Raises:
        BadInputError: It does not expose them, like some of Python's built-ins.
    """
    try:
        return list(inspect.signature(factory).parameters)
    except ValueError as error:
        raise BadInputError(f"{what} {name!r}: its parameters are not known ({error})") from None


def build(
    what: str,
    name: str,
    factory: Any,
    *arguments: object,
    needs: Mapping[str, str] | None = None,
    of_mission: Mapping[str, object] | None = None,
    **options: object,
) -> Any:  # noqa: ANN401
    """Call a user's own class or function; kind (`what`) and name are for messages.

    Args:
        what: Kind of object.
        name: Its name.
        factory: The class or function.
        arguments: Its positional arguments.
        needs: Parameters of the methods that the object must have, by method, separated by commas.
        of_mission: What it may take from the mission, by the name of the parameter; None = unknown.
        options: Its options, with `of_mission` only those that it has.

    Raises:
        BadInputError: It raised, or needs what is unknown, or has no such option, or the object lacks a method, or one
            of these takes other parameters.
    """
    if of_mission is not None:
        options = _arguments(what, name, factory, of_mission, options)
    try:
        instance = factory(*arguments, **options)
    except MavfiError:
        raise
    except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever a user's constructor raises
        raise BadInputError(f"{what} {name!r}: cannot be built ({reason(error)})") from None
    methods = needs or {}
    lacking = [method for method in methods if not callable(getattr(instance, method, None))]
    if lacking:
        raise BadInputError(f"{what} {name!r}: lacks {', '.join(lacking)}")
    for method, parameters in methods.items():
        _check_call(f"{what} {name!r}", method, getattr(instance, method), parameters)
    return instance


def _arguments(
    what: str,
    name: str,
    factory: Any,
    of_mission: Mapping[str, object],
    options: Mapping[str, object],  # noqa: ANN401
) -> dict[str, object]:
    """Arguments by name: what a class takes from the mission, and options, all of which it must have."""
    parameters = parameters_of(what, name, factory)
    from_mission = {key: value for key, value in of_mission.items() if key in parameters}
    for key, value in from_mission.items():
        if value is None:
            raise BadInputError(f"{what} {name!r}: needs the {key} of the mission")
    unknown = sorted(set(options) - set(parameters))
    if unknown:
        raise BadInputError(f"{what} {name!r}: has no option {', '.join(unknown)}")
    return {**from_mission, **options}


def _check_call(owner: str, method: str, function: Any, parameters: str) -> None:  # noqa: ANN401
    """Raise a BadInputError if a method of the owner cannot be called with these parameters in their order."""
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):  # of some compiled functions it is not known
        return
    try:
        signature.bind(*filter(None, parameters.split(", ")))
    except TypeError:
        raise BadInputError(f"{owner}: {method}{signature}: allowed: {method}({parameters})") from None


def reason(error: BaseException) -> str:
    """An exception of user code, on one line."""
    text = " ".join(str(error).split())
    if text:
        return f"{type(error).__name__}: {text}"
    return type(error).__name__


def plugin_failure(error: BaseException) -> str:
    """The exception as one line with plug-in, file, line and function, if a plug-in raised it; "" = mavfi did.

    The innermost frame that belongs to either decides; those of libraries belong to their caller.  A machine without
    memory or space is nobody's fault: "".
    """
    if machine_failure(error) or error.__traceback__ is None:
        return ""
    for frame, line in reversed(list(walk_tb(error.__traceback__))):
        package = _package(frame.f_globals.get("__name__") or "")
        if package == _OWN:
            break
        if package in _loaded:
            # the plug-in whose method the frame executes, or else the first one of its package
            executing_class = type(frame.f_locals.get("self"))
            plugins = _loaded[package]
            name = next((name for name, plugin in plugins.items() if plugin is executing_class), next(iter(plugins)))
            file = Path(frame.f_code.co_filename).name
            return f"{name}: {reason(error)} ({file}:{line}, {frame.f_code.co_name})"
    return ""


def portable(error: BaseException) -> BaseException:
    """The exception if another process can unpickle it, otherwise a `MavfiError` with its text.

    An exception of a plug-in becomes its one line: pickling loses the traceback that names it.
    """
    of_plugin = plugin_failure(error)
    if of_plugin:
        return BadInputError(of_plugin)
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # noqa: BLE001 - third-party exception classes may fail in any way
        return MavfiError(f"{type(error).__name__}: {error}")
    return error


def _package(module: str) -> str:
    """Top-level package of a module."""
    return module.partition(".")[0]


# ---- code of a ledger that its user has allowed before ---------------------------------------------------------------

_TRUST = "trusted-plugins.json"
"""File in the user's own state folder: by ledger, the names that are allowed in it, each with file and hash."""


class _Source(NamedTuple):
    """A plug-in's source: its file, and a hash of it, or of all files of its package."""

    file: str
    sha256: str


def use_ledger(directory: Path, content: object) -> None:
    """Allow the code that a ledger names if the user has allowed it there before, and it has not changed since.

    What is allowed now, since it was typed or with `allow_plugins`, is remembered for this folder.

    Args:
        directory: Folder of the ledger.
        content: Plain data of the ledger, in which code is named.
    """
    names = sorted(set(_code_in(content)))
    if not names:
        return
    ledger = str(directory.resolve())
    remembered = _remembered()
    of_ledger = remembered.get(ledger, {})
    sources = dict(of_ledger)
    for name in names:
        source = _source_of(name)
        if source is None:
            if name in of_ledger:
                _remembered_names.absent[name] = of_ledger[name][0]
            continue
        if of_ledger.get(name) == list(source) and not _is_allowed(name):
            _remembered_names.unchanged.add(name)
            _allow([name])
        elif _is_allowed(name) and name not in _remembered_names.unchanged:
            sources[name] = list(source)
        elif name in of_ledger:
            _remembered_names.changed.add(name)
    if sources != of_ledger:
        _remember({**remembered, ledger: sources})


def permission_for(directory: Path, content: object) -> str:
    """The option, with a space before it, that commands on a ledger need in a further process; "" = none."""
    of_ledger = _remembered().get(str(directory.resolve()), {})
    for name in set(_code_in(content)):
        source = _source_of(name)
        if source is None or of_ledger.get(name) != list(source):
            return " --allow-plugins"
    return ""


def _code_in(content: object) -> Iterator[str]:
    """The addresses of code in plain data, and files of code."""
    if isinstance(content, str):
        if _ADDRESS.fullmatch(content) or content.endswith(_CODE_FILES):
            yield content
    elif isinstance(content, Mapping):
        for value in content.values():
            yield from _code_in(value)
    elif isinstance(content, Sequence):
        for value in content:
            yield from _code_in(value)


def _source_of(name: str) -> _Source | None:
    """The source of a plug-in, found without importing anything; None = it has no file, or is absent."""
    if name.endswith(_CODE_FILES):
        return _hashed(Path(name), [Path(name)])
    folders: Any = [*sys.path, str(Path.cwd())]
    specs = []
    for part in name.partition(":")[0].split("."):
        spec = PathFinder.find_spec(part, folders)
        if spec is None:
            return None
        specs.append(spec)
        folders = spec.submodule_search_locations or []
    if not specs[-1].has_location:
        return None
    file = Path(str(specs[-1].origin))
    package = specs[0].submodule_search_locations
    if not package or not specs[0].has_location:  # a module, or in a folder that is no package of its own
        return _hashed(file, [file])
    return _hashed(file, sorted(path for folder in package for path in Path(folder).rglob("*.py")))


def _hashed(file: Path, files: Iterable[Path]) -> _Source | None:
    """A source with the hash of its files; None if one cannot be read."""
    content = hashlib.sha256()
    try:
        for path in files:
            content.update(f"{path}\n".encode() + path.read_bytes())
    except OSError:
        return None
    return _Source(str(file.resolve()), content.hexdigest())


def _trust_file() -> Path:
    root = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(root) / "mavfi" / _TRUST


def _remembered() -> dict[str, dict[str, list[str]]]:
    """What is remembered, by ledger and name; nothing if the file is not this user's alone."""
    path = _trust_file()
    try:
        about = path.stat()
        if about.st_uid != os.getuid() or about.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
            return {}
        remembered = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    if not isinstance(remembered, dict):
        return {}
    return {ledger: names for ledger, names in remembered.items() if isinstance(names, dict)}


def _remember(trusted: Mapping[str, Mapping[str, Sequence[str]]]) -> None:
    """Replace what is remembered; without a folder that can be written, nothing is."""
    path = _trust_file()
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        with tempfile.NamedTemporaryFile("w", dir=path.parent, delete=False, encoding="utf-8") as file:
            json.dump(trusted, file, indent=1, sort_keys=True)
        Path(file.name).replace(path)
