"""Mutated files and texts for every reader: each is read, or refused in one line; nothing else ever happens.

    python -m tests.nightly.fuzz        (N=100000 SEED=1 ONLY=vehicle)

Inputs are read in forked children, a batch each, with 1 GB more memory than at their start, and 10 s for each input.
A refusal is a `BadInputError` whose line names the file.  Nothing is printed, and no file is left behind.
"""

import contextlib
import json
import os
import random
import resource
import select
import shutil
import signal
import sys
import tempfile
import traceback
from collections import Counter
from functools import partial
from pathlib import Path

from mavfi.cli.console import MAX_LINE_LENGTH, one_line
from mavfi.errors import BadInputError
from tests.nightly.chaos import say
from tests.nightly.mutations import changed, mangled

LONGEST_S = 10
MEMORY = 1 << 30
ROUND = 20_000
"""Inputs of all readers before the first one's next."""
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
    location = f"{frames[-1].filename.rpartition('/mavfi/')[2]}:{frames[-1].lineno} {frames[-1].name}" if frames else ""
    return f"{type(error).__name__} at {location}: {' '.join(str(error).split())[:160]}"


def _memory():
    """Address space of this process (bytes)."""
    with open("/proc/self/status", encoding="ascii") as file:
        return 1024 * next(int(line.split()[1]) for line in file if line.startswith("VmSize"))


def _observed(reader, path, streams, folder):
    """What became of an input in this process: also wrong is what takes too long, prints, or leaves a file."""
    os.ftruncate(streams, 0)
    signal.setitimer(signal.ITIMER_REAL, LONGEST_S)
    outcome = judged(reader, path)
    signal.setitimer(signal.ITIMER_REAL, 0)
    sys.stdout.flush()
    sys.stderr.flush()
    if outcome in (ACCEPTED, REFUSED):
        if os.fstat(streams).st_size:
            outcome = f"prints {os.pread(streams, 200, 0)!r}"
        elif left := os.listdir(folder):
            outcome = f"leaves {left[0]}"
            shutil.rmtree(folder)
            folder.mkdir()
    return outcome


def content_of(reader, seeds, seed, number):
    """The content of an input: structure is changed first, then in one of five cases bytes."""
    draw = random.Random(f"{seed}/{reader.name}/{number}")
    data = reader.encode(changed(draw.choice(seeds), draw, seeds, reader.raw))
    return mangled(data, draw) if draw.random() < 0.2 else data


# ---- batches -------------------------------------------------------------------------------------------------------
def _child(reader, contents, pipe, work):
    """Read inputs, and tell the parent of each when it begins and what became of it."""
    here, streams = work / "here", os.open(work / "streams", os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND)
    here.mkdir(exist_ok=True)
    os.chdir(here)
    os.dup2(streams, 1)
    os.dup2(streams, 2)
    limit = _memory() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    for number, make in contents:
        folder = work / f"{reader.name}-{number}"
        folder.mkdir()
        path = folder / reader.file
        make(path)
        os.write(pipe, json.dumps([number]).encode() + b"\n")
        os.write(pipe, json.dumps([number, _observed(reader, path, streams, here)]).encode() + b"\n")
        shutil.rmtree(folder, ignore_errors=True)


def batch(reader, contents, work):
    """Read inputs in forked children; yields number and outcome of each.

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
        for report in _lines(ours, pid):
            if len(report) == 1:
                begun = report[0]
            else:
                begun = None
                left.pop(0)
                yield tuple(report)
        _, ended = os.waitpid(pid, 0)
        if begun is not None:
            left.pop(0)
            shutil.rmtree(work / f"{reader.name}-{begun}", ignore_errors=True)
            yield begun, _death(ended)
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


# ---- all -----------------------------------------------------------------------------------------------------------
def fuzz(readers, count, seed, work, tell=lambda text: None, keep=None):
    """Read mutated inputs; gives outcomes by reader, and findings: by reader and text, the numbers of the inputs.

    Args:
        readers: Which.
        count: Inputs in all, shared as the readers say.
        seed: Of the mutations.
        work: Folder that is empty.
        tell: Called with a line of progress.
        keep: Folder in which the first input of each finding is kept.
    """
    shares = sum(reader.share for reader in readers)
    outcomes, findings = {reader.name: Counter() for reader in readers}, {}
    prepared = {reader.name: _prepared(reader, work) for reader in readers}
    for begin in range(0, count, ROUND):
        for reader in readers:
            seeds = prepared[reader.name]
            first, last = (reader.share * min(end, count) // shares for end in (begin, begin + ROUND))
            contents = [(n, partial(_write, reader, seeds, seed, n)) for n in range(first, last)]
            for number, outcome in batch(reader, contents, work):
                if outcome in (ACCEPTED, REFUSED):
                    outcomes[reader.name][outcome] += 1
                    continue
                outcomes[reader.name]["wrong"] += 1
                if (reader.name, outcome) not in findings:
                    tell(f"{reader.name} {number}: {outcome}")
                    if keep is not None:
                        _write(reader, seeds, seed, number, keep / f"{reader.name}-{seed}-{number}-{reader.file}")
                findings.setdefault((reader.name, outcome), []).append(number)
        tell(_total(outcomes, findings))
    return outcomes, findings


def _total(outcomes, findings):
    return f"{sum(counts.total() for counts in outcomes.values())} inputs, {len(findings)} findings"


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


def main():
    """Fuzz, tell, fail if something was found."""
    from tests.nightly.readers import READERS

    count, seed = int(os.environ.get("N", "100000")), int(os.environ.get("SEED", "1"))
    chosen = [reader for reader in READERS.values() if os.environ.get("ONLY", "") in ("", reader.name)]
    keep = Path(os.environ["KEEP"]) if "KEEP" in os.environ else None
    os.environ.pop("MAVFI_ALLOW_PLUGINS", None)
    with tempfile.TemporaryDirectory(prefix="mavfi-fuzz-") as folder:
        outcomes, findings = fuzz(chosen, count, seed, Path(folder), say, keep)
    for name, counts in outcomes.items():
        say(f"{name:>12} " + ", ".join(f"{counts[key]} {key}" for key in (ACCEPTED, REFUSED, "wrong")))
    for (name, text), numbers in findings.items():
        say(f"{len(numbers):5} x {name} {numbers[0]}: {text}")
    say(_total(outcomes, findings))
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
