"""Kernels are prepared by forks of a process that has compiled nothing; it ends with the program that needs it."""

import gc
import json
import os
import signal
import sys
import threading
import time
from functools import partial
from pathlib import Path

import numba
import pytest

from mavfi.errors import MachineError
from mavfi.extras.ros.processes import is_alive
from mavfi.ir import fresh
from mavfi.ir.build import BuildError, run_in_fresh_process
from mavfi.ir.forked import run_in_child
from mavfi.numerics.jit import KernelDispatcher, kernel_jit

pytestmark = pytest.mark.slow


@kernel_jit
def half(x):
    return 0.5 * x


def surroundings_of(kernel, signature):
    """Of the process that prepares: its template, where it is, how much it had compiled, and a variable."""
    others = sum(isinstance(thing, KernelDispatcher) and bool(thing.overloads) for thing in gc.get_objects())
    cache = list(map(str, Path(os.environ["NUMBA_CACHE_DIR"]).rglob("*.nb?")))
    return json.dumps([os.getppid(), os.getcwd(), others, cache, os.environ.get("FOR_FORKS")]).encode()


def hang(kernel, signature):
    time.sleep(60)


def report_and_hang(kernel, signature, pid_file):
    pid_file.with_suffix(".part").write_text(f"{os.getppid()} {os.getpid()}", encoding="utf-8")
    pid_file.with_suffix(".part").rename(pid_file)
    hang(kernel, signature)


def die(kernel, signature):
    os.kill(os.getpid(), signal.SIGABRT)


def answers():
    return json.loads(run_in_fresh_process(half, (numba.float64,), surroundings_of))


def template():
    return answers()[0]


def wait_for_end(pid):
    until = time.monotonic() + 30
    while is_alive(pid):
        assert time.monotonic() < until, "the template is still there"
        time.sleep(0.02)


def test_one_template_serves_all_requests_and_each_fork_has_settings_and_empty_caches_of_its_own(tmp_path, monkeypatch):
    first = answers()
    monkeypatch.setenv("FOR_FORKS", "set")
    monkeypatch.chdir(tmp_path)
    second = answers()
    assert first == [first[0], first[1], 0, [], None]
    assert second == [first[0], str(tmp_path), 0, [], "set"]
    assert first[0] != os.getpid()


def test_it_is_no_child_of_the_program_and_ends_with_its_thread():
    parents = []
    thread = threading.Thread(target=lambda: parents.append(template()))
    thread.start()
    thread.join()
    with pytest.raises(ChildProcessError):
        os.waitpid(parents[0], os.WNOHANG)
    wait_for_end(parents[0])


def test_forks_of_the_program_have_their_own():
    first = template()
    forked = run_in_child(lambda: str(template()).encode())
    assert int(forked.payload) != first == template()


def test_other_settings_need_another_one(monkeypatch):
    first = template()
    assert template() == first
    monkeypatch.setenv("NUMBA_OPT", "2")
    assert template() != first
    monkeypatch.setenv("NUMBA_OPT", "1")
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(MachineError, match="the process that prepares kernels has ended"):
        template()


def test_one_that_has_ended_is_replaced(monkeypatch):
    first = template()
    os.kill(first, signal.SIGKILL)
    wait_for_end(first)
    assert template() != first


def test_a_fork_that_hangs_or_dies_leaves_the_template():
    first = template()
    assert fresh.run_fresh(half, (numba.float64,), hang, 0.2).detail == "wall clock"
    with pytest.raises(BuildError, match="half: the compiler ended with SIGABRT"):
        run_in_fresh_process(half, (numba.float64,), die)
    assert template() == first


def test_what_is_prepared_for_a_program_that_is_killed_is_given_up(tmp_path):
    pid_file = tmp_path / "pids"
    program = os.fork()
    if program == 0:
        try:
            run_in_fresh_process(half, (numba.float64,), partial(report_and_hang, pid_file=pid_file))
        finally:
            os._exit(0)
    while not pid_file.exists():
        assert os.waitpid(program, os.WNOHANG) == (0, 0)
        time.sleep(0.02)
    os.kill(program, signal.SIGKILL)
    os.waitpid(program, 0)
    for pid in pid_file.read_text(encoding="utf-8").split():
        wait_for_end(int(pid))


def test_after_ctrl_c_an_answer_that_is_not_wanted_any_more_is_not_read(monkeypatch):
    first = template()

    def interrupted(reader):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(fresh, "_read", interrupted)
        with pytest.raises(KeyboardInterrupt):
            template()
    assert template() != first
