"""Mutated files and texts for every reader: each is read, or refused in one line; nothing else ever happens.

    python -m tests.nightly.fuzz        (N=100000 SEED=1 ONLY=vehicle)

Inputs are read in forked children, a batch each, with 1 GB more memory than at their start, and 10 s for each input.
A refusal is a `BadInputError` whose line names the file.  Nothing is printed, and no file is left behind.  Some of the
inputs that were refused are given to the command line as well: exit code 2, and one line on stderr.
"""

import contextlib
import json
import os
import random
import resource
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from mavfi.cli.console import MAX_LINE_LENGTH, one_line
from mavfi.errors import BadInputError

LONGEST_S = 10
MEMORY = 1 << 30
ROUND = 20_000
"""Inputs of all readers before the first one's next."""
COMMANDS = 2000
"""Of so many refused inputs one is given to the command line."""
_COMMAND_S = 120
_GRACE_S = 20
_NAMED = (
    "environment ",
    "generator ",
    "planner ",
    "platform ",
    "autopilot ",
    "parameter ",
    "detector ",
    "host ",
    "campaign ",
    "model ",
)
"""What a line names instead of the file: names of files in a file, and things that have a name in their file."""
ACCEPTED, REFUSED = "accepted", "refused"


@dataclass
class Tally:
    """What became of a reader's inputs."""

    counts: Counter = field(default_factory=Counter)
    slowest: float = 0.0
    largest: int = 0
    commands: int = 0

    def note(self, outcome, seconds, grown):
        """Count an outcome, its time (s) and memory (bytes)."""
        self.counts[outcome if outcome in (ACCEPTED, REFUSED) else "wrong"] += 1
        self.slowest, self.largest = max(self.slowest, seconds), max(self.largest, grown)


# ---- one input -----------------------------------------------------------------------------------------------------
def judged(reader, path):
    """What became of an input: `ACCEPTED`, `REFUSED`, or what is wrong."""
    try:
        reader.read(path)
    except BadInputError as error:
        return _wrong_line(one_line(str(error)), path) or REFUSED
    except BaseException as error:  # noqa: BLE001 - whatever else a reader raises is a finding
        return _shown(error)
    return ACCEPTED


def _wrong_line(line, path):
    """What is wrong with the line of a refusal; "" = nothing."""
    if not line.strip() or not line.isprintable() or len(line) > MAX_LINE_LENGTH:
        return f"no clear line: {line[:100]!r}"
    if path.suffix != ".txt" and not any(name in line for name in (path.name, str(path.parent), *_NAMED)):
        return f"the line does not name the file: {line[:200]}"
    return ""


def _shown(error):
    """An exception, and where it comes from; without numbers, so that the same defect has the same text."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if "/mavfi/" in frame.filename]
    place = f"{frames[-1].filename.rpartition('/mavfi/')[2]}:{frames[-1].lineno} {frames[-1].name}" if frames else ""
    return f"{type(error).__name__} at {place}: {' '.join(str(error).split())[:160]}"


def _memory(name):
    """A figure of /proc/self/status (bytes)."""
    with open("/proc/self/status", encoding="ascii") as file:
        return 1024 * next(int(line.split()[1]) for line in file if line.startswith(name))


def _measured(reader, path, streams, folder):
    """Outcome, time (s), memory (bytes) of an input, in this process."""
    os.ftruncate(streams, 0)
    with open("/proc/self/clear_refs", "w", encoding="ascii") as file:
        file.write("5")  # resets the peak
    before, start = _memory("VmRSS"), time.perf_counter()
    signal.setitimer(signal.ITIMER_REAL, LONGEST_S)
    outcome = judged(reader, path)
    signal.setitimer(signal.ITIMER_REAL, 0)
    seconds, grown = time.perf_counter() - start, _memory("VmHWM") - before
    sys.stdout.flush()
    sys.stderr.flush()
    if outcome in (ACCEPTED, REFUSED):
        if os.fstat(streams).st_size:
            outcome = f"prints {os.pread(streams, 200, 0)!r}"
        elif left := os.listdir(folder):
            outcome = f"leaves {left[0]}"
            shutil.rmtree(folder)
            folder.mkdir()
    return outcome, seconds, grown


def content_of(reader, seeds, seed, number):
    """The content of an input."""
    return reader.mutate(random.Random(f"{seed}/{reader.name}/{number}"), seeds)


# ---- batches -------------------------------------------------------------------------------------------------------
def _child(reader, contents, pipe, work):
    """Read inputs, and tell the parent of each when it begins and what became of it."""
    here, streams = work / "here", os.open(work / "streams", os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND)
    here.mkdir(exist_ok=True)
    os.chdir(here)
    os.dup2(streams, 1)
    os.dup2(streams, 2)
    limit = _memory("VmSize") + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    for number, make in contents:
        folder = work / f"{reader.name}-{number}"
        folder.mkdir()
        path = folder / reader.file
        make(path)
        os.write(pipe, json.dumps([number]).encode() + b"\n")
        os.write(pipe, json.dumps([number, *_measured(reader, path, streams, here)]).encode() + b"\n")
        shutil.rmtree(folder, ignore_errors=True)


def batch(reader, contents, work):
    """Read inputs in forked children; yields number, outcome, time (s) and memory (bytes) of each.

    A child that dies or hangs takes one input with it, the next child continues with the following one.
    """
    left = list(contents)
    while left:
        ours, theirs = os.pipe()
        pid = os.fork()
        if pid == 0:
            code = 1
            try:
                os.close(ours)
                _child(reader, left, theirs, work)
                code = 0
            except BaseException:  # noqa: BLE001 - the parent learns of it by the exit code
                Path(work / "harness").write_text(traceback.format_exc(), encoding="utf-8")
            finally:
                os._exit(code)
        os.close(theirs)
        begun = None
        for words in _lines(ours, pid):
            if len(words) == 1:
                begun = words[0]
            else:
                begun = None
                left.pop(0)
                yield tuple(words)
        _, ended = os.waitpid(pid, 0)
        if begun is not None:
            left.pop(0)
            shutil.rmtree(work / f"{reader.name}-{begun}", ignore_errors=True)
            yield begun, _death(ended), float(LONGEST_S), 0
        elif ended:
            raise RuntimeError((work / "harness").read_text(encoding="utf-8"))


def _death(ended):
    """How a child ended, in words."""
    if os.WIFSIGNALED(ended):
        name = signal.Signals(os.WTERMSIG(ended)).name
        return "hangs" if name in ("SIGALRM", "SIGKILL") else f"dies of {name}"
    return f"ends the process with {os.WEXITSTATUS(ended)}"


def _lines(pipe, pid):
    """What a child tells, line by line; one that is silent for too long is killed."""
    with os.fdopen(pipe, "rb", buffering=0) as stream:
        held = b""
        while True:
            if not select.select([stream], [], [], LONGEST_S + _GRACE_S)[0]:
                os.kill(pid, signal.SIGKILL)
            data = stream.read(1 << 16)
            if not data:
                return
            *whole, held = (held + data).split(b"\n")
            yield from map(json.loads, whole)


# ---- the command line ----------------------------------------------------------------------------------------------
def commanded(reader, path):
    """What is wrong when a command reads an input that is to be refused; "" = nothing."""
    words = {"folder": str(path.parent), "text": ""}
    if path.suffix == ".txt":
        words["text"] = os.fsdecode(path.read_bytes())
        if "\x00" in words["text"]:
            return ""
    command = [
        word.replace("{}", str(path)).replace("{folder}", words["folder"]).replace("{text}", words["text"])
        for word in reader.command
    ]
    try:
        done = subprocess.run(
            [sys.executable, "-m", "mavfi", *command],
            capture_output=True,
            cwd=path.parent,
            timeout=_COMMAND_S,
            stdin=subprocess.DEVNULL,
            check=False,
            env={**os.environ, "MAVFI_ALLOW_PLUGINS": ""},
        )
    except subprocess.TimeoutExpired:
        return f"mavfi {command[0]} does not end"
    stderr = done.stderr.decode(errors="replace")
    if done.returncode != 2 or stderr.count("\n") != 1 or not stderr.startswith("mavfi: "):
        return f"mavfi {command[0]}: exit code {done.returncode}: {stderr[:200]!r}"
    return ""


# ---- all -----------------------------------------------------------------------------------------------------------
def fuzz(readers, count, seed, work, tell=lambda text: None, commands=COMMANDS, keep=None):
    """Read mutated inputs; gives tallies by reader, and findings: by reader and text, the numbers of the inputs.

    Args:
        readers: Which.
        count: Inputs in all, shared as the readers say.
        seed: Of the mutations.
        work: Folder that is empty.
        tell: Called with a line of progress.
        commands: Of so many refused inputs, one is given to the command line.
        keep: Folder in which the first input of each finding is kept.
    """
    whole = sum(reader.share for reader in readers)
    tallies, findings = {reader.name: Tally() for reader in readers}, {}
    prepared = {reader.name: _prepared(reader, work) for reader in readers}
    for begin in range(0, count, ROUND):
        for reader in readers:
            seeds, tally = prepared[reader.name], tallies[reader.name]
            first, last = (reader.share * min(end, count) // whole for end in (begin, begin + ROUND))
            contents = [(n, partial(_write, reader, seeds, seed, n)) for n in range(first, last)]
            for number, outcome, seconds, grown in batch(reader, contents, work):
                tally.note(outcome, seconds, grown)
                if outcome == REFUSED and reader.command and (number + 7) % commands == 0:
                    outcome = _by_command(reader, content_of(reader, seeds, seed, number), work) or REFUSED
                    tally.commands += 1
                if outcome in (ACCEPTED, REFUSED):
                    continue
                if (reader.name, outcome) not in findings:
                    tell(f"{reader.name} {number}: {outcome}")
                    if keep is not None:
                        _write(reader, seeds, seed, number, keep / f"{reader.name}-{seed}-{number}-{reader.file}")
                findings.setdefault((reader.name, outcome), []).append(number)
        tell(f"{sum(tally.counts.total() for tally in tallies.values())} inputs, {len(findings)} findings")
    return tallies, findings


def _write(reader, seeds, seed, number, path):
    path.write_bytes(content_of(reader, seeds, seed, number))


def _prepared(reader, work):
    """What a reader's mutations begin with."""
    seeds = reader.seeds()
    if reader.warm:
        _warm_up(reader, seeds, work)
    return seeds


def _warm_up(reader, seeds, work):
    """Read what is sound here: children inherit what is imported and compiled."""
    for number, seed in enumerate(seeds):
        folder = work / f"warm-{number}"
        folder.mkdir()
        path = folder / reader.file
        path.write_bytes(reader.encode(seed))
        with contextlib.suppress(BadInputError):
            reader.read(path)
        shutil.rmtree(folder)


def _by_command(reader, content, work):
    folder = work / "command"
    folder.mkdir()
    try:
        (folder / reader.file).write_bytes(content)
        return commanded(reader, folder / reader.file)
    finally:
        shutil.rmtree(folder)


def say(text):
    """One line, at once."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def main():
    """Fuzz, tell, fail if something was found."""
    from tests.nightly.readers import READERS

    count, seed = int(os.environ.get("N", "100000")), int(os.environ.get("SEED", "1"))
    chosen = [reader for reader in READERS.values() if os.environ.get("ONLY", "") in ("", reader.name)]
    keep = Path(os.environ["KEEP"]) if "KEEP" in os.environ else None
    os.environ.pop("MAVFI_ALLOW_PLUGINS", None)
    with tempfile.TemporaryDirectory(prefix="mavfi-fuzz-") as folder:
        tallies, findings = fuzz(chosen, count, seed, Path(folder), say, keep=keep)
    heads = ("reader", 12), ("inputs", 7), ("accepted", 8), ("refused", 8), ("wrong", 6), ("slowest s", 9), ("MB", 6)
    say(" ".join(f"{head:>{width}}" for head, width in (*heads, ("commands", 8))))
    for name, tally in tallies.items():
        numbers = [tally.counts[key] for key in (ACCEPTED, REFUSED, "wrong")]
        say(
            f"{name:>12} {sum(numbers):7} {numbers[0]:8} {numbers[1]:8} {numbers[2]:6} {tally.slowest:9.2f} "
            f"{tally.largest / 1e6:6.0f} {tally.commands:8}"
        )
    for (name, text), numbers in findings.items():
        say(f"{len(numbers):5} x {name} {numbers[0]}: {text}")
    say(f"{sum(tally.counts.total() for tally in tallies.values())} inputs, {len(findings)} findings")
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
