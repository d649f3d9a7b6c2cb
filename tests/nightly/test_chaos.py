"""The harness that kills campaigns: a short run, and what it would notice."""

import random

import pytest

from tests.nightly import chaos

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("golden") / "campaign"


@pytest.fixture(scope="module")
def reference(folder):
    return chaos.undisturbed("instruction", folder)


def test_a_campaign_that_is_killed_again_and_again_has_the_same_ledger(reference, tmp_path):
    hits, draw = [], random.Random(3)
    for number in range(8):
        if len(hits) < 2:
            assert chaos.disturbed("instruction", tmp_path / str(number), reference, 4, draw, hits.append) == []
    assert hits


def test_another_ledger_is_noticed(reference, folder):
    """The campaign is complete, and flies nothing again."""
    other = ("0" * 64, *reference[1:])
    (message,) = chaos.disturbed("instruction", folder, other, 0, random.Random(1))
    assert message.startswith("the ledger differs")


def test_a_traceback_is_noticed_but_for_that_of_a_tracker_which_was_killed():
    ours = 'Traceback (most recent call last):\n  File "src/mavfi/campaign/run.py", line 1\nError\n'
    tracker = 'Traceback (most recent call last):\n  File "lib/multiprocessing/resource_tracker.py", line 1\nKeyError\n'
    assert chaos.tracebacks(tracker * 2 + "Done.") == []
    assert len(chaos.tracebacks(tracker + ours)) == 1
