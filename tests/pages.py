"""Commands and files of the documentation's pages, as they stand there, and how a user runs them."""

import os
import re
import select
import shlex
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress

from tests.core.architecture.source import ROOT

DOCS = ROOT / "docs"
_PROGRAMS = ("make", "mavfi", "python", "$FLIGHT/join")
_FILE = re.compile(r"^```(?:python|yaml|xml)\n(?:# |<!-- )(\S+)(?: -->)?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_SESSION = re.compile(r"^```console\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_ELLIPSIS = "..."
_COMMENT = re.compile(r"\s+# .*$")


def commands(page, section=""):
    """Indented lines that begin with a program, without comments, and lines of a terminal behind its prompt.

    `section`: heading of the section from which on they count; "" = all.
    """
    text = (DOCS / page).read_text(encoding="utf-8")
    lines = text[text.index(section) :].splitlines()
    shown_commands = [_COMMENT.sub("", line.strip()) for line in lines if line.startswith("    ")]
    shown_commands += [line[2:] for line in lines if line.startswith("$ ")]
    return [line for line in shown_commands if line and line.split()[0] in _PROGRAMS]


def files(page):
    """Names and contents of the blocks that name their file in the first line."""
    return _FILE.findall((DOCS / page).read_text(encoding="utf-8"))


def sessions(page):
    """Commands of the page's terminal sessions with the lines that each is shown to print."""
    text = (DOCS / page).read_text(encoding="utf-8")
    blocks = "".join(_SESSION.findall(text))
    steps = blocks.removeprefix("$ ").split("\n$ ")
    return [(command, shown.splitlines()) for command, _, shown in (step.partition("\n") for step in steps)]


def missing(shown, printed):
    """Lines of a page that a command did not print, in this order; `...` stands for anything, frames do not count."""
    lines = iter(" ".join(line.strip(" │").split()) for line in printed.splitlines())
    wanted = [" ".join(line.removesuffix(_ELLIPSIS).split()) for line in shown if line != _ELLIPSIS]
    return [line for line in wanted if not any(printed_line.startswith(line) for printed_line in lines)]


def follow(page, folder, capsys, fewer=()):
    """Write a page's files to a folder, the working directory, and run its commands in order.

    `fewer`: patterns and replacements that make its campaigns small; these then need only end well.
    """
    from mavfi.cli import run

    for name, content in files(page):
        for pattern, text in fewer:
            content = re.sub(pattern, text, content)
        (folder / name).write_text(content, encoding="utf-8")
    for command, shown in sessions(page):
        program, *arguments_of_command = shlex.split(command)
        if program == "python":
            result = subprocess.run(
                [sys.executable, *arguments_of_command], cwd=folder, capture_output=True, text=True, check=False
            )
            assert result.returncode == 0 and missing(shown, result.stdout) == [], result.stdout + result.stderr
            continue
        alone = ["--workers", "1"] if arguments_of_command[:2] == ["campaign", "run"] else []
        assert program == "mavfi" and run([*arguments_of_command, *alone]) == 0, f"{command}: {capsys.readouterr().err}"
        printed = capsys.readouterr().out
        if not fewer or arguments_of_command[0] not in ("campaign", "report"):
            assert missing(shown, printed) == [], printed


def arguments(command, variables):
    """The command for a new process: `mavfi` is this one, variables are set."""
    for name, value in variables.items():
        command = command.replace(f"${name}", str(value))
    program, *rest = shlex.split(command)
    return [sys.executable, "-m", "mavfi", *rest] if program == "mavfi" else [program, *rest]


@contextmanager
def serving(command, says, folder, patience_s=120.0):
    """A command that runs until Ctrl-C: from the line that it says when it is ready, ended by its process id."""
    with subprocess.Popen(
        arguments(command, {}), cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, bufsize=0
    ) as process:
        output, until = b"", time.monotonic() + patience_s
        try:
            while not re.search(says, output.decode(errors="replace")):
                ready, _, _ = select.select([process.stdout], [], [], max(0.0, until - time.monotonic()))
                part = os.read(process.stdout.fileno(), 65_536) if ready else b""
                assert part, f"{command}: {output.decode(errors='replace')}"
                output += part
            yield process
            process.send_signal(signal.SIGINT)
            with suppress(subprocess.TimeoutExpired):
                process.communicate(timeout=20)
            if process.poll() is None:  # the first one arrived in a destructor, whose exceptions Python ignores
                process.send_signal(signal.SIGINT)
                process.communicate(timeout=60)
            assert process.returncode in (0, 130)
        finally:
            process.kill()


@contextmanager
def importing_from(folder, monkeypatch):
    """Modules of a folder can be imported, those named `my_...` only meanwhile."""
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry] + [str(folder)])
    before = set(sys.modules)
    yield
    for name in set(sys.modules) - before:
        if name.startswith("my_"):
            del sys.modules[name]
