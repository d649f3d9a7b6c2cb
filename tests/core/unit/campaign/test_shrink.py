import numpy as np
import polars as pl
import pytest

from mavfi.analysis.runs import Runs
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.shrink import shrink
from mavfi.campaign.store import Store
from mavfi.cli import run
from mavfi.cli.runs import command
from mavfi.errors import BadInputError
from mavfi.faults.strata import WORD_BITS
from mavfi.levels.level import parse, text_of
from mavfi.levels.smaller import change_of
from mavfi.levels.state.fault import StateFault
from mavfi.states import STATES
from tests.campaigns import run_campaign
from tests.core.unit.campaign.fakes import fly, small


@pytest.fixture(scope="module")
def directory(tmp_path_factory):
    directory = tmp_path_factory.mktemp("campaign")
    lasting = {"strata": {"sign_exponent": 1}, "lifetime": {"times": 5, "width": 2}}
    run_campaign(small(environments=["dense"], sampling=lasting), directory, executor=LocalExecutor(1))
    return directory


@pytest.fixture(scope="module")
def lost(directory):
    runs = Runs.read(directory)
    return runs.where(~pl.col("success"), setting="fi")["run_id"]


def test_the_smallest_fault_loses_the_mission_and_no_smaller_one_does(directory, lost):
    from mavfi.campaign.replay import resolve_stored, setup_of_run

    for run_id in lost:
        found = shrink(directory, run_id)
        original, smallest = found.original.fault, found.smallest.fault
        assert found.smallest.lost and (smallest.times, smallest.width) == (1, 1)
        assert (smallest.where, smallest.time_us) == (original.where, original.time_us), "the same site and instant"
        with Store.open(directory) as store:
            setup = setup_of_run(resolve_stored(store), store, found.spec)
        dtype, before = STATES[smallest.where.state].find(smallest.where.field).dtype, found.smallest.injection.before
        size = change_of(before, dtype, smallest.bit)
        for bit in range(WORD_BITS[dtype]):
            if change_of(before, dtype, bit) < size:
                smaller = StateFault(smallest.where, smallest.time_us, bit)
                assert fly(setup, None, smaller).log.status.label == "success", f"bit {bit} is smaller and loses, too"


def test_it_ends_with_a_command_that_flies_the_smallest_fault(capsys, directory, lost):
    smallest = shrink(directory, lost[0])
    text = text_of(smallest.smallest.fault)
    printed = command(smallest)
    assert printed.startswith("mavfi fly --environment dense --seed") and text in printed
    assert parse(text).resolve(0, "published").bit == smallest.smallest.fault.bit
    assert run(["shrink", str(directory), lost[0]]) == 0
    out = capsys.readouterr().out
    assert out.startswith("smallest") and out.splitlines()[-1].split(maxsplit=3)[3] == printed


def test_missions_that_are_not_lost_by_their_fault_are_refused(directory):
    runs = Runs.read(directory)
    fine = runs.where("success", setting="fi").first("run_id")
    with pytest.raises(BadInputError, match="ends in success; allowed: runs whose fault loses the mission"):
        shrink(directory, fine)
    with pytest.raises(BadInputError, match="no fault to make smaller"):
        shrink(directory, runs.golden.first("run_id"))


@pytest.mark.parametrize(
    ("before", "dtype", "bit", "size"),
    [
        (2.0, "f8", 63, 4.0),
        (1.0, "f8", 51, 0.5),
        (1.0, "f8", 62, np.inf),
        (5, "i4", 1, 2.0),
        (1, "i4", 31, 2.0**31),
        (True, "?", 0, 1.0),
        (None, "f8", 7, 7.0),
    ],
)
def test_sizes_of_changes(before, dtype, bit, size):
    assert change_of(before, dtype, bit) == size
