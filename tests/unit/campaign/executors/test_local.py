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
    monkeypatch.setattr(local, "_open", lambda: opened.append(really_open()) or opened[-1])
    assert dict(LocalPool(MOST_WORKERS).run(double, [1])) == {1: 2}
    assert len(opened) == 1


def test_an_exception_comes_through():
    with pytest.raises(ZeroDivisionError):
        list(LocalPool(1).run(explode, [1]))


@pytest.mark.slow
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


@pytest.mark.slow
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


def who(item):
    return os.getpid()


def test_a_group_and_what_follows_from_it_goes_to_one_worker():
    groups = [[(name, number) for number in range(3)] for name in "abcdef"]
    rest = {name: [[(name, 3), (name, 4)], [(name, 5)]] for name in "abcdef"}

    def follow(item):
        return rest[item[0]].pop(0) if item[1] in (2, 4) else []

    results = list(LocalPool(2).run_groups(who, groups, follow))
    assert sorted(item for item, _ in results) == [(name, number) for name in "abcdef" for number in range(6)]
    assert len({worker for _, worker in results}) == 2
    for name in "abcdef":
        mine = [(number, worker) for (group, number), worker in results if group == name]
        assert [number for number, _ in mine] == list(range(6)), "in order"
        assert len({worker for _, worker in mine}) == 1


@pytest.mark.slow
def test_what_follows_from_an_item_that_died_is_done_too(tmp_path):
    path = tmp_path / "deaths"
    path.write_text("100")
    follow = {1: [(5, None)], 2: [(6, None)], 6: [(7, None)]}
    groups = [[(1, None), (2, path)], [(3, None)]]
    results = dict(LocalPool(2).run_groups(die_while_counted, groups, lambda item: follow.get(item[0], [])))
    assert {item[0] for item in results} == {1, 2, 3, 5, 6, 7}
    assert {item[0] for item, result in results.items() if isinstance(result, Lost)} == {2}


def test_empty_groups_are_passed_over():
    results = list(LocalPool(1).run_groups(double, [[], [1], [], [], [2]], lambda _: []))
    assert results == [(1, 2), (2, 4)]
