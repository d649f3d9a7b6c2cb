"""Everyone who loads a trained detector by name hands on for which mission it was trained."""

import pytest

from mavfi import api
from mavfi.campaign.mission import MissionPlan, setup_of
from mavfi.campaign.resolve import resolve
from mavfi.cli import fly
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
    return resolve(campaign, models={"mine": ""})


def setup():
    campaign = by_campaign()
    setup_of(MissionPlan(campaign, "sparse", 1), campaign.arms[1]).make_detector()


CALLERS = {
    "api": (compose, lambda: api.fly(SPEC, detector="limits")),
    "fly": (compose, lambda: fly.watched(SPEC, "limits", None, None)),
    "plan": (compose, lambda: by_campaign().with_models()),
    "flight": (compose, setup),
}


@pytest.mark.parametrize("caller", CALLERS)
def test_the_mission_that_it_was_trained_for_is_handed_on(caller, monkeypatch):
    module, call = CALLERS[caller]
    monkeypatch.setattr(module, "detector_for", ask)
    with pytest.raises(Asked, match=f"^{NAME}$"):
        call()


def test_the_label_of_a_flight_says_so():
    assert fly.watched(SPEC, "limits", None, None).label.endswith(f", trained for {NAME}")
