"""Injections into real processes, and each trap of ptrace."""

import ctypes
import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from mavfi.cli.commands import run
from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.registers import inject
from mavfi.extras.registers.fault import DEFAULT_WALK, RegisterFault
from mavfi.extras.registers.injector import inject_once
from mavfi.extras.registers.ptrace import Tracee


def tracer_of(pid):
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("TracerPid"))


def wait_until(condition, seconds=10.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "did not happen in time"
        time.sleep(0.01)


def has_avx():
    return " avx2 " in Path("/proc/cpuinfo").read_text()


def only(pid, **wanted):
    return inject(pid, RegisterFault(**wanted))[0]


@pytest.mark.slow
def test_an_injection_is_seen_by_the_target_as_it_is_recorded(targets):
    for seed in range(6):
        target, _ = targets.start("hold")
        injection = only(target.pid, seed=seed, registers="general", access="read")
        assert injection.activated and int(injection.before, 16) ^ int(injection.after, 16) == 1 << injection.bit
        if injection.site == "rflags":
            continue  # the branch takes it: nothing is left in rbx or r12
        changed = int(target.communicate(timeout=10)[0], 16)
        assert injection.site in ("rbx", "r12") and changed == 1 << injection.bit


@pytest.mark.slow
def test_an_injection_of_a_vector_register_is_seen_by_the_target(targets):
    if not has_avx():
        pytest.skip("this processor has no AVX")
    seen = set()
    for seed in range(8):
        target, _ = targets.start("hold", "-DVECTOR")
        injection = only(target.pid, seed=seed, registers="fp", access="read")
        assert injection.activated and injection.details["width"] == 256
        changed = int(target.communicate(timeout=10)[0], 16)
        assert changed == 1 << injection.bit
        seen.add(injection.bit >= 128)
    assert seen == {False, True}


@pytest.mark.parametrize("walk", [1, 16])
def test_a_null_fault_changes_nothing_and_says_so(spin, walk):
    for injection in inject(spin.pid, RegisterFault(null=True, access="either", walk=walk), count=20):
        assert injection.activated and injection.before == injection.after
    assert spin.poll() is None


def test_all_but_the_instant_comes_from_the_seed(spin):
    first, again = (inject(spin.pid, RegisterFault(seed=5, null=True, symbol="work"), count=3) for _ in range(2))
    same = ("address", "instruction", "walked", "symbol")
    for one, other in zip(first, again, strict=True):
        assert one.site == other.site and one.bit == other.bit
        assert [one.details[name] for name in same] == [other.details[name] for name in same]
    assert len({injection.details["walked"] for injection in first}) > 1


def test_without_a_symbol_nothing_is_single_stepped(spin, monkeypatch):
    monkeypatch.setattr(Tracee, "step", lambda *_: pytest.fail("the target dies if its tracer dies here"))
    for number in range(5):
        assert inject_once(spin.pid, RegisterFault(null=True), number, 0, bool).details["walked"] == 0
    stepping = RegisterFault(symbol="work")
    assert (stepping.access, stepping.walk, stepping.steps) == ("either", DEFAULT_WALK, True)


def test_a_target_in_a_system_call_is_left_alone(targets):
    target, _ = targets.start("reader")
    with pytest.raises(
        MavfiError, match=r"that reads a register \(\d+ stops in 0.5 s, system calls excluded; --walk looks further\)"
    ):
        only(target.pid, timeout=0.5)
    out, _ = target.communicate("abc", timeout=10)
    assert out == "3 0 abc"  # not interrupted: no EINTR


def test_the_thread_that_computes_is_injected_and_waited_for(targets):
    """It is not the first one: without __WALL, waitpid would not report it."""
    target, worker = targets.start("threads")
    time.sleep(0.3)
    injection = only(target.pid, null=True)
    assert injection.details["thread"] == int(worker) != target.pid


@pytest.mark.slow
def test_a_symbol_is_watched_in_threads_that_come_up_later(targets):
    target, worker = targets.start("threads")
    fault = RegisterFault(null=True, symbol="brief", walk=1)
    for injection in inject(target.pid, fault, count=20):  # some end between being listed and being watched
        assert injection.details["symbol"].startswith("brief")
        assert injection.details["thread"] not in (target.pid, int(worker))
    assert target.poll() is None


@pytest.mark.slow
def test_no_signal_is_lost(targets):
    target, _ = targets.start("signals")
    injected = []
    with suppress(MavfiError):  # it has ended meanwhile
        inject(target.pid, RegisterFault(null=True, access="either", walk=16), count=1_000, tell=injected.append)
    assert len(injected) > 20
    assert target.communicate(timeout=60)[0].strip() == "0"


def test_the_target_survives_the_death_of_the_tool_with_a_breakpoint_set(spin):
    command = [sys.executable, "-m", "mavfi", "inject", "--pid", str(spin.pid), "--symbol", "never"]
    tool = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    wait_until(lambda: tracer_of(spin.pid) != 0)
    tool.kill()
    tool.wait()
    wait_until(lambda: tracer_of(spin.pid) == 0)
    spin.send_signal(signal.SIGUSR2)  # it now calls the function: a breakpoint left behind would kill it
    assert spin.stdout.readline() == "never\n"
    assert spin.poll() is None


def test_a_symbol_that_is_not_called_is_given_up(spin):
    with pytest.raises(MavfiError, match="did not call 'never' within 0.3 s"):
        only(spin.pid, symbol="never", timeout=0.3)
    assert tracer_of(spin.pid) == 0 and spin.poll() is None


@pytest.mark.parametrize("symbol", ["no_such_function", "mem"])
def test_a_symbol_that_is_unknown_or_ambiguous_is_refused(spin, symbol):
    with pytest.raises(BadInputError, match=f"symbol '{symbol}'"):
        only(spin.pid, symbol=symbol)


@pytest.mark.parametrize(
    ("pid", "message"),
    [
        (4_194_000, "there is no such process"),
        pytest.param(os.getpid(), "is mavfi itself", id="mavfi itself"),
        (1, "pid 1: is init"),
        (-1, "pid: -1: allowed:"),
    ],
)
def test_what_is_no_target_is_refused(pid, message):
    with pytest.raises(BadInputError, match=message):
        only(pid)


def state_of(pid):
    return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]


@pytest.mark.parametrize(
    ("number", "state", "message"), [(signal.SIGKILL, "Z", "has ended"), (signal.SIGSTOP, "T", "kill -CONT")]
)
def test_a_target_that_does_not_run_is_refused(spin, number, state, message):
    spin.send_signal(number)
    wait_until(lambda: state_of(spin.pid) == state)
    with pytest.raises(BadInputError, match=message):
        only(spin.pid)


def test_a_target_that_is_traced_is_refused(spin):
    ctypes.CDLL(None).ptrace(0x4206, spin.pid, 0, 0)  # PTRACE_SEIZE
    try:
        with pytest.raises(BadInputError, match=f"traced already, by process {os.getpid()}"):
            only(spin.pid)
    finally:
        spin.kill()


def test_a_thread_in_place_of_a_process_is_refused(targets):
    _, worker = targets.start("threads")
    with pytest.raises(BadInputError, match="is a thread of process"):
        only(int(worker))


@pytest.mark.parametrize(
    ("name", "value"), [("registers", "mmx"), ("access", "execute"), ("walk", -1), ("timeout", 0.0), ("thread", 1)]
)
def test_a_fault_that_makes_no_sense_is_refused(name, value):
    with pytest.raises(BadInputError, match=f"{name}: .*allowed:"):
        RegisterFault(**{name: value})


def test_another_machine_is_refused(monkeypatch):
    monkeypatch.setattr("platform.machine", lambda: "aarch64")
    with pytest.raises(BadInputError, match="x86-64 Linux"):
        only(1)


def test_the_command_tells_what_it_did(spin, capsys):
    assert run(["inject", "--pid", str(spin.pid), "--null", "--count", "2", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert len(record["injections"]) == 2
    assert {"site", "bit", "before", "after", "details"} <= set(record["injections"][0])
    assert {"address", "symbol", "instruction", "register"} <= set(record["injections"][0]["details"])
    assert run(["inject", "--pid", str(spin.pid), "--null"]) == 0
    assert ", unchanged" in capsys.readouterr().out


IDLE = """
import select, os
reader, _ = os.pipe()
print("ready", flush=True)
while True:
    select.select([reader], [], [], 0.05)
"""


def test_a_python_process_that_waits_is_injected_when_its_call_ends():
    with subprocess.Popen([sys.executable, "-c", IDLE], stdout=subprocess.PIPE, text=True) as target:
        try:
            assert target.stdout.readline() == "ready\n"
            for injection in inject(target.pid, RegisterFault(null=True), count=2):
                assert injection.activated and injection.details["symbol"].partition("+")[0] in ("select", "__select")
            assert target.poll() is None
        finally:
            target.kill()
