"""What all tests share: one thread per process, and property tests that are the same on every machine."""

import ctypes
import gc
import os
import signal
from pathlib import Path

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # inherited from a shell that started this in the background
    signal.signal(signal.SIGINT, signal.default_int_handler)
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")  # before numpy is loaded: sums keep their order
os.environ.setdefault("MPLBACKEND", "Agg")
os.environ["MAVFI_ALLOW_PLUGINS"] = "all"
os.environ.pop("COLUMNS", None)  # processes of xdist have it: output is as wide as in a file

import pytest
from hypothesis import settings
from xdist.scheduler import LoadFileScheduling

# The first call of a compiled function takes seconds, so there is no deadline.  By day the same few examples on every
# machine; `make nightly ONLY=properties` looks for new ones with `--hypothesis-profile=night`.
settings.register_profile("day", deadline=None, derandomize=True, max_examples=25)
settings.register_profile("night", deadline=None, max_examples=100)
settings.load_profile("day")


def pytest_addoption(parser):
    parser.addoption("--update-goldens", action="store_true", help="store the digests of the golden flights again")


def pytest_collection_finish():
    """What all tests have imported is not looked at by each collection of garbage: 1 s each time."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def plug_ins_are_those_of_the_test(monkeypatch):
    """Fakes of other tests are in the package of all tests, whose exceptions would be those of a plug-in."""
    from mavfi import plugins

    monkeypatch.setattr(plugins, "_loaded", {})


@pytest.fixture(scope="session", autouse=True)
def what_tests_allow_is_not_remembered_for_the_user(tmp_path_factory):
    """Ledgers of tests, and the plug-ins that are allowed in them, are no concern of whoever runs the tests."""
    os.environ["XDG_STATE_HOME"] = str(tmp_path_factory.mktemp("state"))


_MEMORY = {"limit": 500_000_000}
"""Bytes beyond which a worker gives memory back, after a test."""


def _resident() -> int:
    pages = Path("/proc/self/statm").read_text(encoding="utf-8").split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


def _give_memory_back():
    """What flights and compilers have freed: else a worker grows to gigabytes, and each of its forks copies more."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    _MEMORY["limit"] = max(500_000_000, _resident() + 50_000_000)


def pytest_runtest_logfinish():
    """Each collection takes half a second, so memory is given back when a worker has grown."""
    if _resident() > _MEMORY["limit"]:
        _give_memory_back()


@pytest.fixture(scope="module", autouse=True)
def flights_of_a_file_are_forgotten(request):
    """What a file's functions have cached, flights for the most part, serves no other file."""
    yield
    for function in vars(request.module).values():
        if hasattr(function, "cache_clear") and function.__module__ == request.module.__name__:
            function.cache_clear()


_TRACED = ("tests/extras/registers", "tests/extras/ros")
"""Tests of processes that are traced or that wait for each other: one worker runs them all, one after another."""


class FilesAndTracedProcesses(LoadFileScheduling):
    """A file's tests run in one worker, for the flights that they share; so do all tests of traced processes."""

    def _split_scope(self, nodeid):
        file = super()._split_scope(nodeid)
        return "traced processes" if file.startswith(_TRACED) else file


def pytest_xdist_make_scheduler(config, log):
    return FilesAndTracedProcesses(config, log) if config.getvalue("dist") == "loadfile" else None


_SLOW = frozenset((Path(__file__).parent / "slow.txt").read_text(encoding="utf-8").split())
"""Files whose tests take more than about a second: `make check` leaves them to `make test`."""


def pytest_ignore_collect(collection_path, config):
    """Slow files are not imported where they are not run: that takes longer than most of the other tests."""
    if not collection_path.is_file() or "not slow" not in config.option.markexpr:
        return None
    return collection_path.relative_to(config.rootpath).as_posix() in _SLOW or None


_FIRST = (
    *_TRACED,
    "tests/core/flights",
    "tests/extras/firmware",
    "tests/extras/hardening",
    "tests/extras/paper",
    "tests/extras",
    "tests/core/unit/campaign",
)
"""Files that take longest start first, so that no worker is left with one when the others have ended."""


def pytest_collection_modifyitems(config, items):
    """Mark tests that `make check` leaves out and those of properties, and begin with the longest files."""

    def order(item):
        path = item.path.relative_to(config.rootpath).as_posix()
        return next((rank for rank, prefix in enumerate(_FIRST) if path.startswith(prefix)), len(_FIRST))

    for item in items:
        if item.path.relative_to(config.rootpath).as_posix() in _SLOW:
            item.add_marker(pytest.mark.slow)
        if getattr(item.obj, "is_hypothesis_test", False):
            item.add_marker(pytest.mark.properties)
    items.sort(key=order)
