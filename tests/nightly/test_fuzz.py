"""A sample of the long test `fuzz`, every input that it found, places that are no files, and bad readers."""

import copy
import itertools
import json
import os
import pickle
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from mavfi.cli.console import MAX_LINE_LENGTH, one_line
from mavfi.detectors.registry import load_detector
from mavfi.errors import BadInputError
from mavfi.mission import MissionSpec
from mavfi.plugins import allow_plugins
from tests.nightly import fuzz
from tests.nightly.mutations import RAW
from tests.nightly.readers import CORPUS, READERS, bomb, ledger_of, ledgers, shipped, tricks

QUICK = ("vehicle", "autopilot", "platform", "planner", "study", "detector", "fault", "recording", "damaged")
"""Readers of the sample; the others compile, or fly nowhere for long."""
FILES = [reader for reader in READERS.values() if reader.name != "fault"]


@pytest.fixture(autouse=True)
def patience(monkeypatch):
    """Other tests take the processor meanwhile."""
    monkeypatch.setattr(fuzz, "LONGEST_S", 60)


CLEAN = """
import json, pickle, sys
from tests.nightly.test_fuzz import _outcomes_of
while sys.stdin.buffer.peek(1):
    print(json.dumps(_outcomes_of(*pickle.load(sys.stdin.buffer))), flush=True)
"""


@pytest.fixture(scope="module")
def outcomes():
    """What becomes of contents, each in the file of a reader.

    Forks of this process, in which other tests have begun threads of polars, cannot read a ledger: one of its own does.
    """
    command, pipe = [sys.executable, "-c", CLEAN], subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, cwd=CORPUS.parents[2]) as clean:

        def there(*given):
            pickle.dump(given, clean.stdin)
            clean.stdin.flush()
            return json.loads(clean.stdout.readline())

        yield (
            lambda reader, contents, work: (
                _outcomes(reader, contents, work) if reader.warm else there(reader.name, contents, work)
            )
        )


def _outcomes(reader, contents, work):
    makers = [(n, lambda path, content=content: path.write_bytes(content)) for n, content in enumerate(contents)]
    return [outcome for _, outcome, _, _ in fuzz.batch(reader, makers, work)]


def _outcomes_of(name, contents, work):
    fuzz.LONGEST_S = 60
    os.environ.pop("MAVFI_ALLOW_PLUGINS", None)
    return _outcomes(READERS[name], contents, work)


@pytest.fixture(autouse=True)
def _as_a_user(monkeypatch):
    monkeypatch.delenv("MAVFI_ALLOW_PLUGINS", raising=False)


@pytest.mark.slow
def test_mutated_files_are_read_or_refused_in_one_line(tmp_path):
    tallies, findings = fuzz.fuzz([READERS[name] for name in QUICK], 500, 11, tmp_path, commands=10**9)
    assert findings == {}
    assert all(tally.counts[fuzz.REFUSED] for name, tally in tallies.items() if name != "recording")


@pytest.mark.parametrize("path", sorted(CORPUS.glob("*/*")), ids=lambda path: f"{path.parent.name}-{path.name}")
def test_what_was_read_wrongly_once_is_refused(outcomes, tmp_path, path):
    assert outcomes(READERS[path.parent.name], [path.read_bytes()], tmp_path) == [fuzz.REFUSED]


@pytest.mark.parametrize("word", sorted(RAW))
def test_a_yaml_file_that_is_a_trap_is_refused(outcomes, tmp_path, word):
    vehicle = shipped("configs/vehicles/airsim_quad.yaml")[0]
    contents = [READERS["vehicle"].encode({**vehicle, key: word}) for key in ("name", "mass", "extra")]
    contents.append(RAW[word].encode())
    found = outcomes(READERS["vehicle"], contents, tmp_path)
    assert found[1:] == [fuzz.REFUSED] * 3 and found[0] in (fuzz.ACCEPTED, fuzz.REFUSED)


@pytest.mark.parametrize("trick", tricks(), ids=itertools.count())
@pytest.mark.parametrize("name", ("ledger", "damaged"))
def test_a_ledger_with_foreign_tables_is_refused_or_harmless(outcomes, tmp_path, name, trick):
    [found] = outcomes(READERS[name], [ledger_of(ledgers()[0], trick)], tmp_path)
    assert found in (fuzz.ACCEPTED, fuzz.REFUSED)


def _flown(content, **changes):
    content["runs"][0][7].update(changes)


@pytest.mark.parametrize(
    "spoil",
    (
        lambda content: content["meta"].update(versions={"numpy": float("nan")}),
        lambda content: content["meta"]["identity"].update(models=[]),
        lambda content: content["meta"]["identity"]["campaign"].update(name=3),
        lambda content: content["runs"][0][6].update(seed="x"),
        lambda content: content["runs"][0][6].update(arm="absent"),
        lambda content: _flown(content, flight_time_s="long"),
        lambda content: _flown(content, end="landed"),
        lambda content: _flown(content, alarms=[3]),
    ),
    ids=itertools.count(),
)
def test_a_ledger_with_right_checksums_and_wrong_content_is_refused(outcomes, tmp_path, spoil):
    content = copy.deepcopy(ledgers()[0])
    spoil(content)
    assert outcomes(READERS["ledger"], [ledger_of(content)], tmp_path) == [fuzz.REFUSED]


@pytest.mark.parametrize("name", ("flight", "recording"))
def test_an_archive_that_grows_when_it_is_read_is_refused(outcomes, tmp_path, name):
    reader = READERS[name]
    [found] = outcomes(reader, [bomb(next(iter(reader.seeds()[0])))], tmp_path)
    assert found == (fuzz.REFUSED if name == "flight" else fuzz.ACCEPTED)  # a recording counts as absent


# ---- no files ------------------------------------------------------------------------------------------------------
def loop(path):
    path.symlink_to(path)


def zeros(path):
    path.symlink_to("/dev/zero")


def sparse(path):
    with path.open("wb") as file:
        file.truncate(1 << 40)


PLACES = (os.mkfifo, os.mkdir, loop, zeros, sparse, lambda path: None)


def slow_where_large(reader):
    return pytest.param(reader, id=reader.name, marks=[pytest.mark.slow] * (reader.name == "bag"))


@pytest.mark.parametrize("reader", [slow_where_large(reader) for reader in FILES])
def test_what_is_no_file_is_refused_in_one_line(tmp_path, reader):
    found = [outcome for _, outcome, _, _ in fuzz.batch(reader, list(enumerate(PLACES)), tmp_path)]
    assert set(found) == {fuzz.ACCEPTED if reader.name == "recording" else fuzz.REFUSED}


# ---- what must be noticed ------------------------------------------------------------------------------------------
def raises(path):
    return {}[path.name]


def sleeps(path):
    time.sleep(60)


def eats(path):
    return np.ones(1 << 28)


def prints(path):
    os.write(1, b"x")


def litters(path):
    with open("left", "wb"):
        pass


def dies(path):
    os.kill(os.getpid(), signal.SIGXCPU)


def mumbles(path):
    raise BadInputError("something is wrong")


def screams(path):
    raise BadInputError(f"{path}: \n" + "x" * 10)


@pytest.mark.parametrize(
    ("read", "message"),
    (
        (raises, "KeyError"),
        (sleeps, "hangs"),
        (eats, "MemoryError"),
        (prints, "prints"),
        (litters, "leaves left"),
        (dies, "dies of SIGXCPU"),
        (mumbles, "does not name the file"),
    ),
)
def test_a_bad_reader_is_noticed_and_the_next_input_is_read(outcomes, tmp_path, monkeypatch, read, message):
    monkeypatch.setattr(fuzz, "LONGEST_S", 1)
    reader = replace(READERS["vehicle"], read=lambda path: read(path) if path.read_bytes() == b"bad" else None)
    first, second = outcomes(reader, [b"bad", b"good"], tmp_path)
    assert message in first and second == fuzz.ACCEPTED


def test_seeds_are_read(outcomes, tmp_path):
    for name, reader in READERS.items():
        found = outcomes(reader, [reader.encode(seed) for seed in reader.seeds()], tmp_path)
        assert set(found) <= {fuzz.ACCEPTED, fuzz.REFUSED}, name
        assert fuzz.ACCEPTED in found or name == "ledger", name  # whose host is not allowed to be run


def test_mutations_repeat_with_their_seed():
    for reader in (READERS["autopilot"], READERS["flight"]):
        seeds = reader.seeds()
        first, again = (fuzz.content_of(reader, seeds, 3, 5) for _ in range(2))
        assert first == again != fuzz.content_of(reader, seeds, 3, 6)


# ---- single rules --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("text", ("a\nb", "\x1b[31m", "\x00", "\u202e", "\ud7ff"))
def test_a_line_has_no_character_that_a_terminal_obeys(text):
    assert one_line(f"x {text} y").isprintable()


def test_a_long_line_keeps_its_ends():
    line = one_line("a" + "x" * 10**6 + "b")
    assert len(line) <= MAX_LINE_LENGTH and (line[0], line[-1]) == ("a", "b")


@pytest.mark.parametrize("name", ("builtins:dict", "builtins:exit", "builtins:print"))
def test_what_is_no_detector_is_refused_in_one_line(name):
    allow_plugins()
    with pytest.raises(BadInputError, match=f"detector '{name}'"):
        load_detector(name, "paper", None, {})


@pytest.mark.parametrize("name", ("builtins:dict", "builtins:int", "builtins:print"))
def test_what_is_no_generator_is_refused_in_one_line(tmp_path, name):
    from mavfi.flight.compose import resolve
    from mavfi.sim.environments import build_world

    allow_plugins()
    path = tmp_path / "x.yaml"
    path.write_text(f"name: x\ngenerator: {name}\n")
    environment = resolve(MissionSpec(environment=str(path))).environment
    with pytest.raises(BadInputError, match=f"generator '?{name}"):
        build_world(environment, 1)
