"""The harness that kills campaigns: a short run, and what it would notice."""

import random

import pytest

from tests.robustness import chaos

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    return chaos.undisturbed("instruction", tmp_path_factory.mktemp("golden") / "campaign")


def test_a_campaign_that_is_killed_again_and_again_has_the_same_ledger(reference, tmp_path):
    hits, draw = [], random.Random(3)
    for number in range(8):
        if len(hits) < 4:
            assert chaos.disturbed("instruction", tmp_path / str(number), reference, 4, draw, hits.append) == []
    assert hits


def test_another_ledger_is_noticed(reference, tmp_path):
    other = ("0" * 64, *reference[1:])
    (told,) = chaos.disturbed("instruction", tmp_path / "campaign", other, 0, random.Random(1))
    assert told.startswith("the ledger differs")
