"""Campaigns of faults in instructions: the same ledger for any workers and after a stop; arms, shares, replays."""

import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter

import pytest

from mavfi.campaign.config import Campaign
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.replay import replay
from mavfi.campaign.store import Store
from mavfi.cli import run
from mavfi.outcomes import DUE
from mavfi.record import plain
from tests.campaigns import run_campaign
from tests.night import at_night

pytestmark = pytest.mark.slow

DIED = {effect.label for effect in DUE}


def campaign(faults=3, arms=None, **sampling):
    return Campaign.model_validate(
        {
            "name": "small",
            "environments": ["sparse"],
            "first_seed": 7,
            "missions": 2,
            "faults": faults,
            "sampling": {"level": "instruction"} | sampling,
            "mission": {"v_max": 6.0},
            "arms": arms or {},
        }
    )


def flown_into(directory, config, workers=1, **options):
    return run_campaign(config, directory, executor=LocalExecutor(workers), **options)


def flown_with_a_stop(directory, config, flown):
    """Two workers, stopped by Ctrl-C after a number of flights, and resumed."""

    def interrupt(progress):
        if progress.flown == flown:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(5)  # the signal arrives in here

    with pytest.raises(KeyboardInterrupt):
        flown_into(directory, config, workers=2, progress=interrupt)
    assert flown_into(directory, config, workers=2).complete


def digest(directory):
    with Store.open(directory) as store:
        assert store.complete
        return store.digest()


def runs_of(directory, *settings):
    with Store.open(directory) as store:
        return [run for run in store.runs(done=True) if not settings or run.spec.setting in settings]


# ---- faults in data -------------------------------------------------------------------------------------------------
DATA = {"kernels": ["pid", "point_cloud"], "which": "data"}


@pytest.fixture(scope="module")
def in_data(tmp_path_factory):
    directory = tmp_path_factory.mktemp("data")
    assert flown_into(directory, campaign(**DATA)).complete
    return directory


def test_kernels_have_equal_numbers_and_golden_runs_count_what_they_execute(in_data):
    injected = runs_of(in_data, "fi")
    assert Counter(completed.spec.fault.kernel for completed in injected) == {"pid": 3, "point_cloud": 3}
    golden = {completed.record.digest for completed in runs_of(in_data) if completed.spec.kind == "golden"}
    for completed in injected:
        assert completed.record.kernel.effect in ("masked", "sdc", "exception"), "data neither crash nor hang"
        assert completed.record.kernel.effect != "masked" or completed.record.digest in golden
    counts = [
        completed.record.counts
        for completed in runs_of(in_data)
        if completed.spec.kind == "golden" and completed.record.counts
    ]
    for kernel in ("pid", "point_cloud"):
        kernel_counts = [counted[kernel] for counted in counts if kernel in counted]
        assert len(kernel_counts) == 2, "one for each mission"
        assert all(
            sum(number for *_, number in counted["lines"]) == counted["instructions"] > 0 for counted in kernel_counts
        )


# ---- faults in addresses --------------------------------------------------------------------------------------------
ADDRESSES = {"kernels": ["pid", "point_cloud"], "which": "address"}


@pytest.fixture(scope="module")
def in_addresses(tmp_path_factory):
    directory = tmp_path_factory.mktemp("addresses")
    assert flown_into(directory, campaign(8, **ADDRESSES)).complete
    return directory


def test_workers_and_stops_do_not_matter_to_addresses(in_addresses, tmp_path):
    flown_with_a_stop(tmp_path, campaign(8, **ADDRESSES), flown=9)
    assert digest(tmp_path) == digest(in_addresses)


@pytest.mark.parametrize("effect", ["crash", *at_night("sdc", "masked")])
def test_the_command_gives_the_same_bytes_in_a_fresh_process(in_addresses, effect):
    chosen = next(
        (completed for completed in runs_of(in_addresses, "fi") if completed.record.kernel.effect == effect), None
    )
    if chosen is None:
        pytest.skip(f"no run was {effect}")
    done = subprocess.run(
        [sys.executable, "-m", "mavfi", "replay", str(in_addresses), chosen.spec.run_id, "--json"],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"SOMETHING": "else"},
    )
    verified = json.loads(done.stdout)
    assert verified["same"] and verified["replayable"]
    again = replay(in_addresses, chosen.spec.run_id).record
    assert plain([completed.to_json() for completed in again.injections]) == plain(
        [i.to_json() for i in chosen.record.injections]
    )
    assert again.kernel.effect == chosen.record.kernel.effect


def test_explain_names_line_and_effect(in_addresses, capsys):
    for chosen in {completed.record.kernel.effect: completed for completed in runs_of(in_addresses, "fi")}.values():
        assert run(["explain", str(in_addresses), chosen.spec.run_id]) == 0
        shown = "".join(capsys.readouterr().out.split())
        injection = chosen.record.injections[0]
        assert f"{injection.file}:{injection.line}" in shown
        assert chosen.spec.fault.kernel in shown
        if chosen.record.kernel.effect in DIED:
            assert "".join(chosen.record.kernel.detail.split()) in shown
