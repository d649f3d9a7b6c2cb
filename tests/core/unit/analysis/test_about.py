"""What a report says of a campaign, at each level of faults."""

from mavfi.analysis.runs import drawn
from mavfi.campaign.config import Campaign


def described(**changes):
    content = {"name": "tiny", "environments": ["sparse"], "missions": 9, "faults": 9, **changes}
    campaign = Campaign.model_validate(content)
    return drawn(campaign)


def test_faults_in_states_and_instructions():
    description = described(sampling={"strata": {"sign_exponent": 2}}, mission={"v_max": 4.5})
    assert description["title"] == "campaign tiny · autopilot profile published · i9-9940x · rrt_connect · 4.5 m/s"
    [line] = description["lines"]
    assert line.startswith("9 missions per environment (seeds 10000 to 10008), 9 faults per stage")
    assert line.endswith("drawn sign + exponent 2, fields: all")
    assert (description["profile"], description["each"]) == ("published", "stage")
    description = described(
        sampling={"level": "instruction", "kernels": ["pid"], "share": "kernel"},
        mission={"autopilot": "hardened", "dead_node": "readback"},
    )
    assert (description["profile"], description["each"], description["kernels"]) == ("hardened", "kernel", ["pid"])
    assert description["lines"][-1] == "mission: dead_node readback", "what differs from the defaults"


def test_arms_say_what_differs():
    arms = {
        "gaussian": {"detector": "gaussian"},
        "own": {"detector": "a:B", "profile": "tuned"},
        "plain": {"detector": "a:C"},
        "star": {"planner": "rrt_star"},
    }
    assert described(arms=arms)["lines"][1] == (
        "arms: gaussian (paper), own = a:B (tuned), plain = a:C, star with planner rrt_star; coupling inline; "
        "monitored set paper-13"
    )
