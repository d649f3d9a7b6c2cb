"""A detector that watches states which a mission never has: said where it flies, refused in campaigns."""

import pytest

from mavfi.campaign.config import Campaign
from mavfi.campaign.resolve import resolve
from mavfi.detectors.detector import Detector, blind_spots
from mavfi.errors import BadInputError
from mavfi.flight.compose import prepare
from mavfi.mission import MissionSpec

ESTIMATOR = MissionSpec(environment="sparse", seed=7, localization="estimator")


class TrueOdometry(Detector):
    """Watches a state that only flights without an estimator publish."""

    source = "true_odometry"
    states = ("sensor.odometry", "planning.waypoint")

    def check(self, state, time_us):
        return None


class EitherOdometry(Detector):
    """Made for both localizations."""

    states = ("sensor.odometry", "perception.odometry")


def test_a_flight_warns_of_states_that_it_never_publishes():
    with pytest.warns(UserWarning, match="states: sensor.odometry: never published with localization 'estimator'"):
        prepare(ESTIMATOR, TrueOdometry())


def test_a_detector_for_either_localization_and_published_states_pass():
    for localization in ("truth", "estimator"):
        assert blind_spots(EitherOdometry(), localization) == ""
    assert blind_spots(TrueOdometry(), "truth") == ""
    assert blind_spots(Detector(), "estimator") == ""


def test_a_campaign_is_refused_before_it_flies(monkeypatch):
    monkeypatch.setenv("MAVFI_ALLOW_PLUGINS", "all")
    campaign = Campaign.model_validate(
        {
            "name": "blind",
            "environments": ["sparse"],
            "missions": 1,
            "faults": 1,
            "mission": {"localization": "estimator"},
            "arms": {"blind": {"detector": f"{__name__}:TrueOdometry"}},
        }
    )
    with pytest.raises(BadInputError, match="arm 'blind': detector .*TrueOdometry: states: sensor.odometry"):
        resolve(campaign).with_models()
