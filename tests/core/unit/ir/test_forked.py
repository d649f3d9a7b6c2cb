"""Children: every way to end is distinguished, and nothing is left behind."""

import ctypes
import errno
import gc
import os
import signal
import time
from pathlib import Path

import pytest

from mavfi.errors import MachineError
from mavfi.ir import forked
from mavfi.ir.forked import HANG_EXIT, ForkPoint, run_in_child


def open_files():
    return len(os.listdir("/proc/self/fd"))


def children():
    """Process identifiers of this process's children, zombies among them."""
    pids = set()
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            after_the_name = entry.read_text().rpartition(")")[2].split()
        except (FileNotFoundError, ProcessLookupError):
            continue  # ended since the folder was listed
        parent = int(after_the_name[1])
        if parent == os.getpid():
            pids.add(int(entry.parent.name))
    return pids


@pytest.fixture
def no_child_left():
    """Fails if the test leaves a child; an earlier test's helper process may still run."""
    before = children()
    yield
    assert children() <= before


def crash():
    ctypes.string_at(0)
    return b""


def fail():
    raise ValueError("on purpose")


def test_a_report_comes_back_however_long_it_is():
    report = bytes(range(256)) * 40_000
    assert run_in_child(lambda: report).payload == report
    assert run_in_child(lambda: b"").how == "done"


def test_a_child_does_not_collect_what_it_inherited():
    """A collection writes to each object that it looks at, and so copies the parent's memory."""
    inherited = [object()]

    def looked_at():
        return str(any(thing is inherited for thing in gc.get_objects())).encode()

    assert looked_at() == b"True"
    assert run_in_child(looked_at).payload == b"False"


@pytest.mark.parametrize(
    ("work", "how", "detail"),
    [
        (crash, "crash", "SIGSEGV"),
        (lambda: os.kill(os.getpid(), signal.SIGFPE), "crash", "SIGFPE"),
        (lambda: os._exit(HANG_EXIT), "hang", "instruction budget"),
        (fail, "exception", "ValueError: on purpose"),
        (lambda: os._exit(3), "exception", "ended with status 3 without a report"),
        (lambda: os._exit(0), "exception", "ended with status 0 without a report"),
    ],
)
def test_ends_are_distinguished(work, how, detail, capfd, no_child_left):
    ended = run_in_child(work)
    assert (ended.how, ended.payload, ended.detail) == (how, b"", detail)
    assert capfd.readouterr().err == ""  # no trace of a crash that was meant


def test_the_wall_clock_ends_a_child_that_does_not_end(no_child_left):
    start = time.monotonic()
    ended = run_in_child(lambda: time.sleep(60), timeout=0.2)
    assert (ended.how, ended.detail) == ("hang", "wall clock")
    assert time.monotonic() - start < 5  # far from the child's own end: a guard against hanging, not a measurement


@pytest.mark.slow
@pytest.mark.long
def test_no_file_and_no_child_is_left_after_many(no_child_left):
    run_in_child(lambda: b"")
    before = open_files()
    for i in range(30):
        run_in_child((crash, fail, lambda: b"done")[i % 3])
    assert open_files() == before


@pytest.fixture
def no_collection():
    """Python drops what a signal handler raises during a collection."""
    gc.collect()
    gc.disable()
    yield
    gc.enable()


def test_an_interrupted_parent_ends_its_child(no_collection, no_child_left):
    before = open_files()

    def stop(*_):
        raise KeyboardInterrupt

    previous = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, 0.3)
    try:
        with pytest.raises(KeyboardInterrupt):
            run_in_child(lambda: time.sleep(60))
    finally:
        signal.signal(signal.SIGALRM, previous)
    assert open_files() == before


def killed_from_outside():
    os.kill(os.getpid(), signal.SIGKILL)


def on_a_full_disk():
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def out_of_memory():
    raise MemoryError


@pytest.mark.parametrize(
    ("work", "why"),
    [(killed_from_outside, "killed by SIGKILL"), (on_a_full_disk, "No space left"), (out_of_memory, "out of memory")],
)
def test_failures_of_the_machine_are_no_results(work, why, no_child_left):
    before = open_files()
    with pytest.raises(MachineError, match=why):
        run_in_child(work)
    assert open_files() == before


@pytest.mark.parametrize("work", [lambda: b"result", on_a_full_disk, out_of_memory])
def test_a_child_that_cannot_report_is_no_result(monkeypatch, work):
    def write(handle, data):
        raise OSError(errno.ENOMEM, os.strerror(errno.ENOMEM))

    monkeypatch.setattr(forked, "write_all", write)
    with pytest.raises(MachineError, match="the process of a flight could not report"):
        run_in_child(work)


def test_a_child_ends_with_its_parent():
    def parent():
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            run_in_child(lambda: os.write(writing, str(os.getpid()).encode()) and time.sleep(60))
        grandchild = os.read(reading, 32)
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        return grandchild

    grandchild = int(run_in_child(parent).payload)
    deadline = time.monotonic() + 5
    while os.path.exists(f"/proc/{grandchild}/stat") and time.monotonic() < deadline:
        if " Z " in Path(f"/proc/{grandchild}/stat").read_text():
            break  # ended; whoever adopted it has not looked yet
        time.sleep(0.01)
    else:
        assert not os.path.exists(f"/proc/{grandchild}/stat")


def test_a_process_can_split_in_the_middle_of_its_work():
    point = ForkPoint()
    values = [1]
    with point.guard():
        ended = point.split()
        values.append(2 if point.in_child else 3)
        if ended is None:
            point.finish(bytes(values))
    assert (ended.payload, values, point.in_child) == (b"\1\2", [1, 3], False)
