from mavfi.reports import header
from tests.unit.campaign.analysis.handmade import ABOUT, GOLDEN, UNKNOWN, flown, golden, injected, null, runs


def test_null_runs_are_reported_either_way():
    assert header.null_line(runs(golden(1))) == "Null runs: none flown."
    assert header.null_line(runs(golden(1), null(1, GOLDEN))).startswith("Null runs: all 1 with an empty mask")
    broken = runs(golden(1), golden(2), null(1, flown()), null(2, GOLDEN))
    assert "1 of 2 DIFFER" in header.null_line(broken)
    assert broken.null["run_id"][0] in header.null_line(broken)


def test_runs_that_could_not_be_judged_are_named():
    assert header.unknown_line(runs(golden(1))) == ""
    own = runs(golden(1), injected(1, UNKNOWN))
    assert header.unknown_line(own) == f"Unknown: 1 runs could not be judged: {own.injected['run_id'][0]}"


def test_a_campaign_that_is_not_complete_or_on_design_seeds_says_so():
    assert not any("Not complete" in line or "design seeds" in line for line in header.header(ABOUT))
    lines = header.header({**ABOUT, "done": 1, "on_design_seeds": True})
    assert any("Not complete" in line for line in lines)
    assert any("design seeds" in line for line in lines)


def test_what_was_flown_comes_first_and_our_version_before_others():
    assert header.header(ABOUT) == [
        "campaign handmade", "9 missions", "9 of 9 runs done · digest dddddddddddddddd…", "mavfi 1 · numba 2"
    ]  # fmt: skip
