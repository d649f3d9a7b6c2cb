import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mavfi.campaign.executors.executor import Done, Lost, map_each
from mavfi.campaign.executors.local import MOST_WORKERS, LocalExecutor
from mavfi.errors import BadInputError, MavfiError


def count_to(number):
    yield from range(number)


def process(number):
    yield os.getpid()
    yield os.getpid()


def explode(number):
    yield number
    raise ZeroDivisionError(number)


class PrivateError(Exception):
    """Cannot be made again from its text."""

    def __init__(self, number, other):
        super().__init__(f"{number} and {other}")


def explode_privately(number):
    yield number
    raise PrivateError(number, 2)


def yield_what_no_pipe_takes(number):
    yield lambda: number


def die(item):
    """Item: number, and how it dies after its first result; None = it does not."""
    number, how = item
    yield number
    if isinstance(how, signal.Signals):
        os.kill(os.getpid(), how)
    elif how is not None:
        os._exit(how)
    yield -number


def die_after(item):
    """The worker dies as soon as it is idle again."""
    yield item
    if item == 1:
        pid, parent = os.getpid(), os.fork()
        if parent == 0:
            time.sleep(0.2)
            os.kill(pid, signal.SIGKILL)
            os._exit(0)


def hang(seconds):
    yield "begun"
    time.sleep(seconds)
    yield "over"


def double(item):
    return None if item is None else 2 * item


def flat(batches):
    return [(mission, item) for mission, items in batches for item in items]


def singly(batches):
    return (item for _, items in batches for item in items)


def items_of(results, item):
    return [result for mission, result in results if mission == item]


@pytest.mark.parametrize("workers", [1, 2])
def test_what_a_mission_gives_comes_in_its_order_and_ends_with_done(workers):
    results = flat(LocalExecutor(workers).map(count_to, range(9)))
    assert len(results) == sum(range(9)) + 9
    for number in range(9):
        assert items_of(results, number) == [*range(number), Done()]


def test_items_are_handed_over_while_the_mission_continues():
    results = LocalExecutor(1).map(hang, [60.0])
    assert next(results) == (60.0, ["begun"])
    results.close()


def test_a_mission_stays_with_its_worker_and_workers_are_used_again():
    results = flat(LocalExecutor(2).map(process, range(8)))
    workers = [{pid for pid in items_of(results, number) if not isinstance(pid, Done)} for number in range(8)]
    assert all(len(pids) == 1 for pids in workers)
    assert len(set.union(*workers)) == 2
    assert os.getpid() not in set.union(*workers)


@pytest.mark.slow
def test_no_worker_outlives_the_parent_even_if_one_was_replaced():
    code = """
import os, signal, sys, time
from mavfi.campaign.executors.local import LocalExecutor

def mission(number):
    yield os.getpid()
    if number == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(60.0 if number > 1 else 0.3)

for number, items in LocalExecutor(2).map(mission, range(9)):
    for item in items:
        print(number, item, flush=True)
"""
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    workers = {}
    for line in parent.stdout:
        number, item = line.split(" ", 1)
        if item.strip().isdigit():
            workers[int(number)] = int(item)
        if {2, 3} <= set(workers):
            break
    parent.kill()
    parent.wait()
    parent.stdout.close()
    until = time.monotonic() + 5.0
    living = [workers[2], workers[3]]
    while living and time.monotonic() < until:
        living = [pid for pid in living if is_alive(pid)]
        time.sleep(0.05)
    assert living == []


def is_alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] not in "ZX"
    except OSError:
        return False


def test_absurd_numbers_of_workers_are_refused_before_any_is_forked():
    LocalExecutor(MOST_WORKERS)
    for number in (0, 100_000):
        with pytest.raises(BadInputError, match=rf"workers: {number}; allowed: 1 to \d+ \(4 per processor\)"):
            LocalExecutor(number)


def test_an_exception_comes_through_as_text_if_it_cannot_be_sent():
    results = LocalExecutor(1).map(explode, [1])
    assert next(results) == (1, [1]), "what was given before comes through first"
    with pytest.raises(ZeroDivisionError):
        next(results)
    with pytest.raises((MavfiError, PrivateError), match="1 and 2"):  # itself where Dask, once imported, can send it
        flat(LocalExecutor(1).map(explode_privately, [1]))
    with pytest.raises((AttributeError, MavfiError), match="lambda"):
        flat(LocalExecutor(1).map(yield_what_no_pipe_takes, [1]))


@pytest.mark.parametrize(("how", "reason"), [(signal.SIGKILL, "SIGKILL"), (7, "exit code 7")])
def test_a_worker_that_dies_loses_its_mission_only(how, reason):
    missions = [(number, how if number == 2 else None) for number in range(1, 7)]
    results = flat(LocalExecutor(2).map(die, missions))
    for mission in missions:
        items = items_of(results, mission)
        if mission[1] is None:
            assert items == [mission[0], -mission[0], Done()]
        else:
            assert items[0] == mission[0], "what it gave before is kept"
            by = reason if isinstance(how, signal.Signals) else ""
            assert items[1:] == [Lost(f"its worker died ({reason})", died=True, signal=by)]


def test_a_worker_that_dies_while_it_is_idle_loses_what_it_is_given_next():
    def slowly():
        yield 1
        time.sleep(0.5)
        yield from (2, 3)

    results = flat(LocalExecutor(1).map(die_after, slowly()))
    assert items_of(results, 1) == [1, Done()]
    assert [result.died for result in items_of(results, 2) if isinstance(result, Lost)] == [True]
    assert items_of(results, 3) == [3, Done()]


def test_a_worker_that_gives_nothing_is_lost_but_not_dead():
    results = flat(LocalExecutor(1, time_limit=0.2).map(hang, [60.0, 0.0]))
    assert items_of(results, 60.0) == ["begun", Lost("its worker gave nothing for 0.2 s", died=False)]
    assert items_of(results, 0.0) == ["begun", "over", Done()]


@pytest.mark.parametrize("leave", ["close", "raise"])
def test_leaving_early_ends_the_workers(leave):
    results = LocalExecutor(2).map(process_and_hang, [0, 1, 2])
    pids = {next(results)[1][0], next(results)[1][0]}
    if leave == "close":
        results.close()
    else:
        with pytest.raises(KeyboardInterrupt):
            results.throw(KeyboardInterrupt)
    assert len(pids) == 2
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def process_and_hang(number):
    yield os.getpid()
    time.sleep(60.0)


def test_map_each_gives_every_result_once_whatever_it_is():
    results = dict(map_each(LocalExecutor(2), double, [*range(25), None]))
    assert results == {**{item: 2 * item for item in range(25)}, None: None}


def exit_hard(item):
    os._exit(3)


def test_map_each_says_what_was_lost():
    with pytest.raises(MavfiError, match=r"seven: its worker died \(exit code 3\)"):
        list(map_each(LocalExecutor(1), exit_hard, ["seven"]))


def short_of_memory(number):
    yield number
    raise MemoryError


def test_a_mission_without_memory_is_reported_as_such(capfd):
    results = singly(LocalExecutor(1).map(short_of_memory, [5]))
    assert next(results) == 5
    with pytest.raises(MemoryError):
        next(results)
    assert capfd.readouterr().err == ""
