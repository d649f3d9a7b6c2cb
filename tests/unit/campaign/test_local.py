import os
import time

import pytest

from mavfi.campaign.executors import local
from mavfi.campaign.executors.local import MOST_WORKERS, LocalPool, Lost
from mavfi.errors import BadInputError


def double(item):
    return 2 * item


def explode(item):
    raise ZeroDivisionError(item)


def die_while_counted(item):
    """Item: number, and a file with how often the worker dies of it."""
    number, path = item
    if path is not None:
        left = int(path.read_text())
        if left > 0:
            path.write_text(str(left - 1))
            os._exit(7)
    return number


def sleep(item):
    time.sleep(item)
    return item


@pytest.mark.parametrize("workers", [1, 2])
def test_every_item_comes_back_once(workers):
    results = dict(LocalPool(workers).run(double, range(25)))
    assert results == {item: 2 * item for item in range(25)}


def test_nothing_to_do():
    assert list(LocalPool(1).run(double, [])) == []


def test_no_workers_are_bad_input():
    with pytest.raises(BadInputError, match=r"workers: 0; allowed: 1 to \d+ \(4 per processor\)"):
        LocalPool(0)


def test_absurd_numbers_of_workers_are_refused_before_any_is_forked():
    LocalPool(MOST_WORKERS)
    with pytest.raises(BadInputError, match="workers: 100000; allowed: 1 to"):
        LocalPool(100_000)


def test_there_are_never_more_workers_than_items(monkeypatch):
    opened, really_open = [], local._open
    monkeypatch.setattr(local, "_open", lambda workers: opened.append(workers) or really_open(workers))
    assert dict(LocalPool(MOST_WORKERS).run(double, [1])) == {1: 2}
    assert opened == [1]


def test_an_exception_comes_through():
    with pytest.raises(ZeroDivisionError):
        list(LocalPool(1).run(explode, [1]))


@pytest.mark.parametrize(("deaths", "survives"), [(1, True), (3, True), (4, False)])
def test_deaths_are_tried_again_alone_three_times(tmp_path, deaths, survives):
    path = tmp_path / "deaths"
    path.write_text(str(deaths))
    items = [(number, path if number == 2 else None) for number in range(8)]
    results = list(LocalPool(2).run(die_while_counted, items))
    assert [item for item, _ in results][-1] == items[2], "suspects come last"
    assert {item: result for item, result in results[:-1]} == {item: item[0] for item in items if item[1] is None}
    last = results[-1][1]
    assert last == 2 if survives else isinstance(last, Lost) and last.died


def test_a_worker_that_does_not_answer_is_lost_but_not_dead(monkeypatch):
    monkeypatch.setattr("mavfi.campaign.executors.local.ATTEMPTS_ALONE", 1)
    [(item, result)] = LocalPool(1, time_limit=0.2).run(sleep, [30.0])
    assert item == 30.0
    assert isinstance(result, Lost)
    assert not result.died


def test_leaving_early_stops_the_workers():
    started = time.perf_counter()
    results = LocalPool(1).run(sleep, [0.0, 60.0, 60.0])
    assert next(results) == (0.0, 0.0)
    results.close()
    assert time.perf_counter() - started < 20
