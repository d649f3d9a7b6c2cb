"""What a report says of a campaign, at each level of faults."""

from mavfi.analysis.runs import drawn
from mavfi.campaign.config import Campaign


def described(**changes):
    content = {"name": "tiny", "environments": ["sparse"], "missions": 9, "faults": 9, **changes}
    campaign = Campaign.model_validate(content)
    return drawn(campaign)


def test_states():
    found = described(sampling={"strata": {"sign_exponent": 2}}, mission={"v_max": 4.5})
    assert found["title"] == "campaign tiny · autopilot profile published · i9-9940x · rrt_connect · 4.5 m/s"
    [line] = found["lines"]
    assert line.startswith("9 missions per environment (seeds 10000 to 10008), 9 faults per stage")
    assert line.endswith("drawn sign + exponent 2, fields: all")
    assert (found["profile"], found["each"]) == ("published", "stage")


def test_instructions():
    sampling = {"level": "instruction", "kernels": ["pid"], "share": "kernel"}
    found = described(sampling=sampling, mission={"autopilot": "hardened"})
    assert found["lines"][0].endswith("instructions: all, model one_bit")
    assert (found["profile"], found["each"], found["kernels"]) == ("hardened", "kernel", ["pid"])


def test_arms_say_what_differs():
    arms = {
        "gaussian": {"detector": "gaussian"},
        "own": {"detector": "a:B", "profile": "tuned"},
        "star": {"planner": "rrt_star"},
    }
    assert described(arms=arms)["lines"][1] == (
        "arms: gaussian (paper), own = a:B (tuned), star with planner rrt_star; coupling inline; monitored set paper-13"
    )


def test_trials_on_a_node():
    node = {
        "name": "/n",
        "command": ["/bin/n"],
        "inputs": {"topic": "/i", "type": "std_msgs/Float64", "messages": [{}]},
        "outputs": {"topic": "/o"},
    }
    found = described(
        host="node",
        node=node,
        environments=["n"],
        missions=1,
        sampling={"level": "register", "symbol": "f", "walk": 64},
    )
    assert found["title"] == "campaign tiny · node n" and found["profile"] == ""
    assert found["lines"] == ["/bin/n · one bit per trial, from the next call of 'f' on, after up to 64 instructions"]


def test_registers_of_a_firmware():
    found = described(host="firmware", mission={"flight_controller": "betaflight"}, sampling={"level": "register"})
    assert found["title"].startswith("campaign tiny · autopilot profile published")
    assert found["lines"][0].endswith("faults per kind of registers, uniform over the firmware's instructions")
    assert found["lines"][1] == "mission: flight_controller betaflight"


def test_policies_and_rules_that_are_not_the_defaults_are_named():
    found = described(mission={"dead_node": "readback", "alarm": "repeated", "epoch_liveness": 2})
    assert found["lines"][-1] == "mission: dead_node readback, alarm repeated, epoch_liveness 2.0"
