"""A sample of the long test `fuzz`, every input that it found, places that are no files, and bad readers."""

import copy
import json
import os
import pickle
import subprocess
import sys
import time
from dataclasses import replace

import pytest

from mavfi.cli.console import MAX_LINE_LENGTH, one_line
from mavfi.errors import BadInputError
from tests.night import at_night
from tests.nightly import fuzz
from tests.nightly.fuzz import ACCEPTED, REFUSED
from tests.nightly.mutations import RAW
from tests.nightly.readers import CORPUS, READERS, TRICKS, bomb, ledger_of, ledgers, shipped

QUICK = ("vehicle", "autopilot", "platform", "planner", "study", "detector", "fault", "recording", "damaged")
"""Readers of the sample; the others compile, or fly nowhere for long."""


@pytest.fixture(autouse=True)
def _as_a_patient_user(monkeypatch):
    """Plug-ins are not allowed; other tests take the processor meanwhile."""
    monkeypatch.delenv("MAVFI_ALLOW_PLUGINS", raising=False)
    monkeypatch.setattr(fuzz, "LONGEST_S", 60)


CLEAN = """
import json, pickle, sys
from tests.nightly.test_fuzz import clean_outcomes
while sys.stdin.buffer.peek(1):
    print(json.dumps(clean_outcomes(*pickle.load(sys.stdin.buffer))), flush=True)
"""


@pytest.fixture(scope="module")
def outcomes():
    """What becomes of contents, each in the file of the reader that is named.

    Forks of this process, in which other tests have begun threads of polars, cannot read a ledger: one of its own does.
    """
    command, pipe = [sys.executable, "-c", CLEAN], subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, cwd=CORPUS.parents[2]) as clean:

        def there(*arguments):
            pickle.dump(arguments, clean.stdin)
            clean.stdin.flush()
            return json.loads(clean.stdout.readline())

        yield there


def clean_outcomes(name, contents, work):
    fuzz.LONGEST_S = 60
    os.environ.pop("MAVFI_ALLOW_PLUGINS", None)
    return outcomes_here(READERS[name], contents, work)


def outcomes_here(reader, contents, work):
    makers = [(n, lambda path, content=content: path.write_bytes(content)) for n, content in enumerate(contents)]
    return [outcome for _, outcome in fuzz.batch(reader, makers, work)]


@pytest.mark.slow
def test_mutated_files_are_read_or_refused_in_one_line(tmp_path):
    counts, findings = fuzz.fuzz([READERS[name] for name in QUICK], 500, 11, tmp_path)
    assert findings == {}
    assert all(counted[REFUSED] for name, counted in counts.items() if name != "recording")


@pytest.mark.parametrize("folder", sorted(CORPUS.iterdir()), ids=lambda folder: folder.name)
def test_what_was_read_wrongly_once_is_refused(outcomes, tmp_path, folder):
    files = sorted(folder.iterdir())
    read_outcomes = outcomes(folder.name, [path.read_bytes() for path in files], tmp_path)
    assert dict(zip(files, read_outcomes, strict=True)) == dict.fromkeys(files, REFUSED)


def test_a_yaml_file_that_is_a_trap_is_refused(outcomes, tmp_path):
    vehicle = shipped("configs/vehicles/airsim_quad.yaml")[0]
    contents = {(word, key): READERS["vehicle"].encode({**vehicle, key: word}) for word in RAW for key in ("mass", "x")}
    contents |= {(word, ""): text.encode() for word, text in RAW.items()}
    read_outcomes = outcomes("vehicle", list(contents.values()), tmp_path)
    assert dict(zip(contents, read_outcomes, strict=True)) == dict.fromkeys(contents, REFUSED)


@pytest.mark.parametrize("name", ["ledger", "damaged"])
def test_a_ledger_with_foreign_tables_is_refused_or_harmless(outcomes, tmp_path, name):
    read_outcomes = outcomes(name, [ledger_of(ledgers()[0], trick) for trick in TRICKS], tmp_path)
    assert len(read_outcomes) == len(TRICKS) and set(read_outcomes) <= {ACCEPTED, REFUSED}


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("meta", "versions"), {"numpy": float("nan")}),
        (("meta", "identity", "models"), []),
        (("meta", "identity", "campaign", "name"), 3),
        (("runs", 0, 6, "seed"), "x"),
        (("runs", 0, 6, "arm"), "absent"),
        (("runs", 0, 7, "flight_time_s"), "long"),
        (("runs", 0, 7, "end"), "landed"),
        (("runs", 0, 7, "alarms"), [3]),
    ],
)
def test_a_ledger_with_right_checksums_and_wrong_content_is_refused(outcomes, tmp_path, path, value):
    content = copy.deepcopy(ledgers()[0])
    *owners, key = path
    owner = content
    for name in owners:
        owner = owner[name]
    owner[key] = value
    assert outcomes("ledger", [ledger_of(content)], tmp_path) == [REFUSED]


@pytest.mark.parametrize(("name", "outcome"), [("flight", REFUSED), ("recording", ACCEPTED)])
def test_an_archive_that_grows_when_it_is_read_is_refused(outcomes, tmp_path, name, outcome):
    """A recording that cannot be read counts as absent."""
    content = bomb(next(iter(READERS[name].seeds()[0])))
    assert outcomes(name, [content], tmp_path) == [outcome]


# ---- no files ------------------------------------------------------------------------------------------------------
def loop(path):
    path.symlink_to(path)


def zeros(path):
    path.symlink_to("/dev/zero")


def sparse(path):
    with path.open("wb") as file:
        file.truncate(1 << 40)


FILES_BY_DAY = ("vehicle", "campaign", "flight", "recording")
PLACES = (os.mkfifo, os.mkdir, loop, zeros, sparse, lambda path: None)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*FILES_BY_DAY, *at_night(*sorted(READERS.keys() - {*FILES_BY_DAY, "fault"}))])
def test_what_is_no_file_is_refused_in_one_line(tmp_path, name):
    read_outcomes = [outcome for _, outcome in fuzz.batch(READERS[name], list(enumerate(PLACES)), tmp_path)]
    assert read_outcomes == [ACCEPTED if name == "recording" else REFUSED] * len(PLACES)


# ---- what must be noticed ------------------------------------------------------------------------------------------
def raises(path):
    return {}[path.name]


def sleeps(path):
    time.sleep(60)


def litters(path):
    with open("left", "wb"):
        pass


def mumbles(path):
    raise BadInputError("something is wrong")


@pytest.mark.parametrize(
    ("read", "message"),
    [
        (raises, "KeyError"),
        (sleeps, "hangs"),
        (litters, "leaves left"),
        (mumbles, "does not name the file"),
    ],
)
def test_a_bad_reader_is_noticed_and_the_next_input_is_read(tmp_path, monkeypatch, read, message):
    monkeypatch.setattr(fuzz, "LONGEST_S", 1)
    reader = replace(READERS["vehicle"], read=lambda path: read(path) if path.read_bytes() == b"bad" else None)
    first, second = outcomes_here(reader, [b"bad", b"good"], tmp_path)
    assert message in first and second == ACCEPTED


@pytest.mark.long
def test_seeds_are_read(outcomes, tmp_path):
    for name, reader in READERS.items():
        read_outcomes = outcomes(name, [reader.encode(seed) for seed in reader.seeds()], tmp_path)
        assert set(read_outcomes) <= {ACCEPTED, REFUSED}, name
        assert ACCEPTED in read_outcomes or name == "ledger", name  # whose host is not allowed to be run


# ---- single rules --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("text", ["a\nb", "\x1b[31m", "\x00", "\u202e", "\ud7ff", "x" * 10**6])
def test_a_line_has_no_character_that_a_terminal_obeys_and_keeps_its_ends(text):
    line = one_line(f"x {text} y")
    assert line.isprintable() and len(line) <= MAX_LINE_LENGTH and (line[0], line[-1]) == ("x", "y")
