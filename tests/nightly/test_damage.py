"""The harness that damages ledgers: a short run, and what it would notice."""

import random

import pytest

from mavfi.campaign.store import Store
from tests.nightly import damage

pytestmark = pytest.mark.slow


@pytest.fixture
def bench(tmp_path):
    return damage.Bench(tmp_path, random.Random(2))


def test_no_damage_of_a_ledger_is_silent(bench):
    damage.damage(bench, 60)
    assert bench.wrong == []
    ends = {end for _, end in bench.judged}
    assert ends == {"refused", "without effect", "not complete"}


@pytest.mark.long
def test_a_ledger_that_is_not_checked_is_noticed(bench, monkeypatch):
    monkeypatch.setattr(Store, "_check_content", lambda self: None)
    damage.flips(bench, 40)
    damage.moves(bench, 2)
    assert any("silent" in line for line in bench.wrong)
