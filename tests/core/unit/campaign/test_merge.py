"""Any split of a campaign, flown and merged in any order, leaves the ledger of the whole."""

import random
from contextlib import suppress

import pytest

from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.ledger import merge, status
from mavfi.campaign.plan import WHOLE, Shard
from mavfi.campaign.store import Store
from mavfi.errors import BadInputError
from tests.campaigns import run_campaign
from tests.core.unit.campaign.fakes import TROUBLE, small
from tests.core.unit.campaign.test_run import TOTAL, digest, stop_at
from tests.night import at_night


def fly(directory, shard=WHOLE, campaign=None, **options):
    return run_campaign(campaign or small(), directory, executor=LocalExecutor(1), shard=shard, **options)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    directory = tmp_path_factory.mktemp("whole")
    fly(directory)
    return directory


@pytest.fixture(scope="module")
def halves(tmp_path_factory):
    folder = tmp_path_factory.mktemp("halves")
    for number in (1, 2):
        fly(folder / str(number), Shard(number, 2))
    return [folder / "1", folder / "2"]


@pytest.mark.slow
@pytest.mark.parametrize("shards", [3, *at_night(2, 11)])
def test_shards_killed_on_the_way_and_merged_in_any_order_are_the_campaign(whole, tmp_path, shards):
    draw = random.Random(shards)
    directories = [tmp_path / str(number) for number in range(1, shards + 1)]
    ends = []
    for number, directory in enumerate(directories, 1):
        with suppress(KeyboardInterrupt):
            fly(directory, Shard(number, shards), progress=stop_at(draw.randrange(1, 30)))
        ends.append(fly(directory, Shard(number, shards)))
    assert all(end.complete for end in ends)
    assert sum(end.total for end in ends) == TOTAL
    draw.shuffle(directories)
    merge(directories[1:], tmp_path / "all")
    assert status(tmp_path / "all").complete is not any(run_counts(directories[0]))
    merged = merge([directories[0], directories[-1]], tmp_path / "all")
    assert (merged.complete, merged.done, merged.shard) == (True, TOTAL, WHOLE)
    assert digest(tmp_path / "all") == digest(whole)


def test_a_shard_says_which_it_is_and_stays_the_one(halves):
    merged = status(halves[0])
    assert (merged.complete, merged.shard) == (True, Shard(1, 2))
    with pytest.raises(BadInputError, match="holds shard 1/2, not 2/2; choose another directory"):
        fly(halves[0], Shard(2, 2))
    with pytest.raises(BadInputError, match="holds shard 1/2, not 1/1; choose another directory"):
        fly(halves[0])


def test_the_campaign_continues_in_what_was_merged_so_far(halves, whole, tmp_path):
    merged = merge(halves[:1], tmp_path)
    assert not merged.complete and merged.total == TOTAL
    assert fly(tmp_path).complete
    assert digest(tmp_path) == digest(whole)


def test_ledgers_that_do_not_belong_together_are_refused(halves, tmp_path, monkeypatch):
    fly(tmp_path / "another", Shard(2, 2), small(first_seed=20_000))
    merge(halves[:1], tmp_path / "all")
    with pytest.raises(
        BadInputError, match=r"all: holds another campaign \(differs in: campaign.first_seed: 10000, not 20000"
    ):
        merge([tmp_path / "another"], tmp_path / "all")
    message = r"another: holds another campaign than \S*1 \(differs in: campaign.first_seed: 10000, not 20000"
    with pytest.raises(BadInputError, match=message):
        merge([halves[0], tmp_path / "another"], tmp_path / "new")
    assert not (tmp_path / "new").exists(), "nothing is written before all are known to belong together"
    with Store.create(tmp_path / "all", identity(halves[0])) as store:
        store.write_meta({"versions": {**store.meta("versions"), "numpy": "1.0"}})
    with pytest.raises(BadInputError, match=r"all: was begun with numpy 1.0, .*halves.*/2 with "):
        merge(halves[1:], tmp_path / "all")


def test_two_records_of_one_run_that_differ_are_refused_and_named(whole, halves, tmp_path, monkeypatch):
    monkeypatch.setattr(TROUBLE, "stray", 3.0)
    fly(tmp_path / "strayed", Shard(1, 2))
    with Store.open(halves[0]) as first_half, Store.open(tmp_path / "strayed") as other:
        runs = zip(first_half.runs(), other.runs(), strict=True)
        first = next(a.spec.run_id for a, b in runs if a.record != b.record)
    merge(halves, tmp_path / "all")
    with pytest.raises(BadInputError, match=f"strayed: run '{first}': has another record than in"):
        merge([tmp_path / "strayed"], tmp_path / "all")
    assert digest(tmp_path / "all") == digest(whole), "what was there stays as it is"


def run_counts(directory):
    """Numbers of planned runs, by setting; a shard may have no mission."""
    return [planned for planned, _, _ in status(directory).settings.values()]


def identity(directory):
    with Store.open(directory) as store:
        return store.meta("identity")
