"""Digests of docs/results.md: those of its digests.json, of the program's own study, in its order."""

import re

import pytest

from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.store import Store
from mavfi.extras.paper.study import load_study
from mavfi.report.text import short
from tests.campaigns import run_campaign
from tools import published_digests
from tools.markers import DOCS

KNOWN = published_digests.stored_digests()
QUICK = pytest.mark.skipif(
    "quick" not in KNOWN, reason="docs/results.md has no digests of scale quick: `make reproduce readme` adds them"
)


def test_the_page_has_the_digests_of_the_results():
    assert published_digests.block(KNOWN) in (DOCS / "results.md").read_text(encoding="utf-8")
    study = (DOCS / "results" / "study.md").read_text(encoding="utf-8")
    whole = re.findall(r"^- Digest of the ledger in \S+ \((\S+)\): (\S+)\.$", study, re.MULTILINE)
    assert [(name, digest) for name, _, digest in KNOWN["paper"]["ledgers"]] == [
        (name, short(digest)) for name, digest in whole
    ]
    assert f"- Program: {KNOWN['paper']['program']}." in study


@pytest.mark.parametrize("scale", KNOWN)
def test_the_digests_of_the_page_are_those_of_what_this_program_flies(scale):
    campaigns = load_study("paper").at_scale(scale).campaigns_at(scale)
    assert [name for name, *_ in KNOWN[scale]["ledgers"]] == [campaign.name for campaign in campaigns.values()]
    assert KNOWN[scale]["fingerprint"] == published_digests.fingerprint(scale), (
        f"campaigns or golden flights have changed: `make reproduce readme SCALE={scale}` flies them again"
    )


@QUICK
@pytest.mark.long
def test_a_campaign_of_scale_quick_has_the_digest_of_the_page(tmp_path):
    campaign = load_study("paper").campaigns_at("quick")["states"]
    run_campaign(campaign, tmp_path, executor=LocalExecutor(2))
    digests = {name: digest for name, _, digest in KNOWN["quick"]["ledgers"]}
    with Store.open(tmp_path) as store:
        assert short(store.digest()) == digests[campaign.name]


def test_changed_campaigns_have_another_fingerprint(monkeypatch):
    before = published_digests.fingerprint("quick")
    assert before == published_digests.fingerprint("quick") != published_digests.fingerprint("paper")
    study = load_study("paper")
    other = {
        folder: campaign.model_copy(update={"faults": 1}) for folder, campaign in study.campaigns_at("quick").items()
    }
    monkeypatch.setattr(type(study), "campaigns_at", lambda *_: other)
    assert published_digests.fingerprint("quick") != before
