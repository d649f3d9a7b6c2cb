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


def test_what_was_flown_at_each_level():
    first, second, *_ = header.header(ABOUT)
    assert first == "campaign handmade · autopilot profile published · i9-9940x · rrt_connect"
    assert second.endswith("9 faults per stage, drawn sign + exponent 2, fields: all")
    own = {**ABOUT, "level": "instruction", "which": "all", "model": "one_bit", "scheme": "stratified", "v_max": 4.5}
    first, second, *_ = header.header(own)
    assert first.endswith("· 4.5 m/s")
    assert second.endswith("instructions: all, model one_bit, drawn by value class and source line")
    node = {**ABOUT, "node": "/n", "command": ["/bin/n"], "symbol": "f", "walk": 64}
    assert header.header(node)[:2] == [
        "campaign handmade · node /n",
        "/bin/n · one bit per trial, from the next call of 'f' on, after up to 64 instructions",
    ]


def test_arms_say_what_differs():
    arms = {
        "gaussian": {"detector": "gaussian", "profile": "paper"}, "own": {"detector": "a:B", "profile": "tuned"},
        "star": {"detector": "", "profile": "paper", "mission": {"planner": "rrt_star"}},
    }  # fmt: skip
    [line] = [line for line in header.header({**ABOUT, "arms": arms}) if line.startswith("arms")]
    assert line == (
        "arms: gaussian (paper), own = a:B (tuned), star with planner rrt_star; coupling inline; "
        "monitored set paper-13"
    )  # fmt: skip
