"""Everyone who loads a trained detector by name hands on for which mission it was trained."""

import pytest

from mavfi import api
from mavfi.campaign import mission
from mavfi.campaign.mission import MissionPlan, host_of, model_hashes, scenarios_of, setup_of
from mavfi.campaign.plan import Arm, arms_of
from mavfi.cli import fly
from mavfi.extras.bench import scores
from mavfi.extras.paper import overheads
from mavfi.flight import compose
from mavfi.mission import MissionSpec
from tests.core.unit.campaign.fakes import small

NAME, SPEC = "published/i9-9940x", MissionSpec(environment="sparse", trained_for="published/i9-9940x")


class Asked(Exception):  # noqa: N818 - no error
    """A detector was asked for; its argument is the mission that it was trained for."""


def ask(scenario, name, profile, models_dir=None, trained_for="", options=None):
    raise Asked(trained_for)


def by_campaign():
    campaign = small(arms={"mine": {"detector": "limits", "trained_for": NAME}}, host="local")
    (arm,) = arms_of(campaign)[1:]
    return campaign, arm


def hashes():
    campaign, arm = by_campaign()
    model_hashes(campaign, scenarios_of(campaign, [arm]), None)


def setup():
    campaign, arm = by_campaign()
    plan = MissionPlan(campaign, "sparse", 1, models={"mine": ""})
    setup_of(plan, arm, host_of(campaign)).make_detector()


def score(spec, overrides):
    arm = Arm("mine", overrides, "limits", "tuned")
    scores._score(scores._ScoringTask(spec, (arm,), (), ()))


CALLERS = {
    "api": (compose, lambda: api.fly(SPEC, detector="limits")),
    "fly": (compose, lambda: fly.watched(SPEC, "limits", None, None)),
    "overheads": (overheads, lambda: overheads.cost(SPEC, "limits", "tuned")),
    "plan": (mission, hashes),
    "flight": (mission, setup),
    "scores": (scores, lambda: score(SPEC, {})),
    "scores of an arm": (scores, lambda: score(MissionSpec(environment="sparse"), {"trained_for": NAME})),
}


@pytest.mark.parametrize("caller", CALLERS)
def test_the_mission_that_it_was_trained_for_is_handed_on(caller, monkeypatch):
    module, call = CALLERS[caller]
    monkeypatch.setattr(module, "detector_for", ask)
    with pytest.raises(Asked, match=f"^{NAME}$"):
        call()


def test_the_label_of_a_flight_says_so():
    assert fly.watched(SPEC, "limits", None, None).label.endswith(f", trained for {NAME}")
