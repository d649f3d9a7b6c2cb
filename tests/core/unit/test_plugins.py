import json
import sys
from importlib.metadata import EntryPoint
from types import SimpleNamespace

import pytest

from mavfi import cli
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.errors import BadInputError, NotInstalledError
from mavfi.plugins import (
    _RememberedNames,
    allow_plugins,
    allow_typed,
    allowed_names,
    build,
    extensions,
    known,
    load_object,
    permission_for,
    plugin_failure,
    use_ledger,
)

SHIPPED = {"here": "mavfi.errors:MavfiError"}
GROUP = "mavfi.no_such_group"


def load(name):
    return load_object("thing", name, GROUP, SHIPPED)


def test_shipped_names_entry_points_and_addresses_are_found():
    assert load("here").__name__ == "MavfiError"
    assert load("mavfi.errors:BadInputError") is BadInputError
    assert "cuboids" in known("mavfi.environments", {})


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nowhere", "allowed: here, or package:Class"),
        ("no_such_package:X", "cannot be imported .ModuleNotFoundError"),
        ("mavfi.errors:Missing", "cannot be imported .mavfi.errors has no Missing"),
        (".relative:X", "not known"),
        (":X", "not known"),
        ("folder/module.py:X", "not known; allowed: here, or package:Class"),
        ("mavfi.errors:__doc__", "cannot be called"),
    ],
)
def test_what_cannot_be_loaded_is_one_line(name, message):
    with pytest.raises(BadInputError, match=message) as caught:
        load(name)
    assert str(caught.value).startswith(f"thing {name!r}: ") and "\n" not in str(caught.value)


def test_an_entry_point_that_cannot_be_imported_is_one_line(monkeypatch):
    broken = EntryPoint("broken", "no_such_package:X", GROUP)
    monkeypatch.setattr("mavfi.plugins.entry_points", lambda group: [broken] if group == GROUP else [])
    with pytest.raises(BadInputError, match=r"entry point 'broken' of mavfi.no_such_group: .* \(ModuleNotFoundError"):
        extensions(GROUP)


def test_a_level_of_an_extra_that_is_not_installed_is_refused_with_the_command(monkeypatch, tmp_path):
    (tmp_path / "level_of_an_extra.py").write_text("import msgpack\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(sys.modules, "msgpack", None)
    with pytest.raises(NotInstalledError, match=r"level 'faulty'.*mavfi\[airsim\]"):
        load_object("level", "faulty", "mavfi.levels", {"faulty": "level_of_an_extra:Level"})


def test_a_constructor_that_raises_and_a_missing_method_are_named():
    with pytest.raises(BadInputError, match="cannot be built .TypeError"):
        build("thing", "x", dict, 1, 2, 3)
    with pytest.raises(BadInputError, match="lacks search"):
        build("thing", "x", dict, needs={"keys": "", "search": "counter"})
    assert build("thing", "x", dict, needs={"keys": ""}, a=1) == {"a": 1}


def test_a_method_with_other_parameters_is_refused_before_its_first_call():
    def made(check):
        return lambda: SimpleNamespace(check=check)

    needs = {"check": "state, time_us"}
    for fine in (lambda state, now: None, lambda *values: None, lambda state, now, more=1: None, max):
        assert build("thing", "x", made(fine), needs=needs)
    for wrong, signature in ((lambda state: None, r"\(state\)"), (lambda a, b, c: None, r"\(a, b, c\)")):
        with pytest.raises(BadInputError, match=rf"^thing 'x': check{signature}: allowed: check\(state, time_us\)$"):
            build("thing", "x", made(wrong), needs=needs)


@pytest.fixture
def strangers_files(monkeypatch):
    monkeypatch.delenv("MAVFI_ALLOW_PLUGINS")


@pytest.mark.usefixtures("strangers_files")
def test_code_that_is_only_named_in_a_file_is_neither_imported_nor_run(tmp_path, monkeypatch):
    (tmp_path / "evil_plugin.py").write_text(
        "import pathlib\npathlib.Path('was_run').touch()\nX = dict\n", encoding="utf-8"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    for name in ("evil_plugin:X", "pydoc:pipepager", "builtins:dict"):
        with pytest.raises(BadInputError, match="named in a file, and so not run; allowed: .*--allow-plugins"):
            load(name)
    assert not (tmp_path / "was_run").exists() and str(tmp_path) not in sys.path
    allow_typed(["fly", "--planner", "evil_plugin:X", None, "state:planning.waypoint.x:bit=62@20"])
    assert load("evil_plugin:X") is dict and (tmp_path / "was_run").exists()
    with pytest.raises(BadInputError):
        load("builtins:dict")
    allow_plugins()
    assert load("builtins:dict") is dict
    assert load("here").__name__ == "MavfiError", "shipped ones need nothing"


@pytest.mark.usefixtures("strangers_files")
def test_code_that_was_allowed_in_a_ledger_is_remembered_until_it_changes(tmp_path, monkeypatch):
    (tmp_path / "my_plugin.py").write_text("X = dict\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    content = {"campaign": {"arms": {"mine": {"detector": "my_plugin:X"}}, "mission": {"map": "dense"}}}
    mine = tmp_path / "mine"

    def is_allowed(ledger, typed=""):
        """What a new process allows after it has opened the ledger."""
        monkeypatch.setenv("MAVFI_ALLOW_PLUGINS", typed)
        monkeypatch.setattr("mavfi.plugins._remembered_names", _RememberedNames())
        use_ledger(ledger, content)
        return "my_plugin:X" in allowed_names()

    assert not is_allowed(mine)
    assert permission_for(mine, content) == " --allow-plugins"
    assert is_allowed(mine, typed="my_plugin:X")
    assert is_allowed(mine)
    assert permission_for(mine, content) == ""
    assert not is_allowed(tmp_path / "foreign"), "a ledger that came from elsewhere"
    is_allowed(mine)
    use_ledger(tmp_path / "foreign", content)
    assert not is_allowed(tmp_path / "foreign"), "opened beside a trusted one"

    (tmp_path / "my_plugin.py").write_text("X = list\n", encoding="utf-8")
    assert not is_allowed(mine)
    with pytest.raises(BadInputError, match="its source has changed since you allowed it for this ledger"):
        load("my_plugin:X")
    assert is_allowed(mine, typed="my_plugin:X")
    assert is_allowed(mine)
    (tmp_path / "state" / "mavfi" / "trusted-plugins.json").chmod(0o666)
    assert not is_allowed(mine), "others may have written it"
    (tmp_path / "state" / "mavfi" / "trusted-plugins.json").chmod(0o600)
    (tmp_path / "state" / "mavfi" / "trusted-plugins.json").write_text("[1", encoding="utf-8")
    assert not is_allowed(mine)
    assert "my_plugin" not in sys.modules, "nothing is imported to find it"


@pytest.mark.usefixtures("strangers_files")
@pytest.mark.parametrize(
    ("text", "arguments"),
    [
        ("name: gates\ngenerator: pydoc:pipepager\n", ["fly", "--environment", "FILE"]),
        (
            "name: c\nenvironments: [sparse]\nmissions: 1\nmission: {map: 'pydoc:pipepager'}\n",
            ["campaign", "run", "FILE", "--out", "OUT"],
        ),
        (
            "name: c\nenvironments: [sparse]\nmissions: 1\narms: {own: {detector: 'pydoc:pipepager'}}\n",
            ["campaign", "run", "FILE", "--out", "OUT"],
        ),
    ],
)
def test_a_strangers_file_is_refused_in_one_line(text, arguments, tmp_path, capsys):
    (tmp_path / "file.yaml").write_text(text, encoding="utf-8")
    places = {"FILE": str(tmp_path / "file.yaml"), "OUT": str(tmp_path / "out")}
    assert cli.run([places.get(word, word) for word in arguments]) == 2
    stderr = capsys.readouterr().err
    assert "'pydoc:pipepager': named in a file, and so not run" in stderr and stderr.count("\n") == 1


_BOTH = """
import json
from mavfi.errors import allowed


class One:
    def check(self, text):
        return self.deeper(text)

    def deeper(self, text):
        return json.loads(text)


class Other(One):
    def check(self, names):
        return allowed(names)
"""


def _failure(call, *arguments):
    with pytest.raises(Exception) as caught:  # noqa: PT011 - any
        call(*arguments)
    return plugin_failure(caught.value)


def test_an_exception_of_mavfi_is_none_of_a_plugin(tmp_path, monkeypatch):
    (tmp_path / "two_plugins.py").write_text(_BOTH, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    allow_plugins()
    other = load("two_plugins:Other")()
    assert _failure(other.check, 5) == "", "raised in a function of mavfi"
    assert _failure(lambda: 1 / 0) == "", "no plug-in takes part"
    assert plugin_failure(ValueError("never raised")) == ""
    monkeypatch.setattr(json, "loads", _without_memory)
    assert _failure(other.deeper, "{}") == "", "of the machine"


def _without_memory(text):
    raise MemoryError


def _decode(text):
    yield load("two_plugins:One")().check(text)


def test_an_exception_of_a_plugin_in_a_worker_keeps_its_place(tmp_path, monkeypatch):
    (tmp_path / "two_plugins.py").write_text(_BOTH, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    allow_plugins()
    with pytest.raises(BadInputError, match=r"^two_plugins:One: JSONDecodeError: .* \(two_plugins.py:11, deeper\)$"):
        list(LocalExecutor(1).map(_decode, ["}"]))
