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

# The first call of a compiled function takes seconds, so there is no deadline; `--hypothesis-profile=search` looks
# for new examples instead of repeating the same ones.
settings.register_profile("repeatable", deadline=None, derandomize=True, max_examples=100)
settings.register_profile("search", deadline=None, max_examples=2000)
settings.load_profile("repeatable")


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


_ALONE = (
    "tests/extras/registers",
    "tests/extras/ros/node/test_attach",
    "tests/extras/ros/node/test_node_campaign",
    "tests/extras/ros/lockstep/test_processes.py",
)
"""Other processes take part in these tests, and keep the time of the wall: they want the processors for themselves.
Most wait most of the time, so two files run at once."""


_SLOW = frozenset((Path(__file__).parent / "slow.txt").read_text(encoding="utf-8").split())
"""Files whose tests take more than half a second of processor time: `make check` leaves them to `make test`."""


def pytest_ignore_collect(collection_path, config):
    """Files without a test that was asked for are not imported: that takes longer than most of these tests."""
    if not collection_path.is_file() or collection_path.suffix != ".py":
        return None
    name = collection_path.relative_to(config.rootpath).as_posix()
    if config.option.markexpr.startswith("alone"):
        is_alone = name.startswith(_ALONE) or "mark.alone" in collection_path.read_text(encoding="utf-8")
        return None if is_alone else True
    if "not slow" in config.option.markexpr and name in _SLOW:
        return True
    return None


def pytest_collection_modifyitems(config, items):
    """The longest files start first; a file's tests stay in one process, for the flights that they share."""
    for item in items:
        path = item.path.relative_to(config.rootpath).as_posix()
        if path.startswith(_ALONE):
            item.add_marker(pytest.mark.alone)
        if path in _SLOW:
            item.add_marker(pytest.mark.slow)
    items.sort(key=lambda item: _order(item.path.as_posix()))


_ORDER = {  # that of the first prefix counts; files that take longest start first
    "tests/extras/registers/test_inject": 0,
    "tests/extras/ros/lockstep": 0,
    "tests/core/flights": 1,
    "tests/extras/firmware": 1,
    "tests/extras/hardening": 2,
    "tests/extras/paper": 2,
    "tests/extras": 3,
    "tests/core/unit/campaign": 3,
}


def _order(path):
    """The longest files first: none is left when the others have ended."""
    return next((place for prefix, place in _ORDER.items() if prefix in path), 5)
