import pytest

from mavfi.campaign.resolve import resolve as resolve_campaign
from mavfi.detectors.autoencoder import AutoencoderDetector
from mavfi.detectors.detector import NoDetector
from mavfi.detectors.gaussian import GaussianDetector
from mavfi.detectors.registry import OF_OWN, load_detector, mission_keys
from mavfi.errors import BadInputError, SpecMismatchError
from mavfi.flight.compose import with_keys_of
from mavfi.mission import MissionSpec
from tests.core.unit.campaign.fakes import small

FITS = {"stack": "published", "platform": "i9-9940x", "v_max": 3.0, "planner": "rrt_connect"}


@pytest.mark.parametrize(("name", "kind"), [("gaussian", GaussianDetector), ("autoencoder", AutoencoderDetector)])
def test_the_detectors_of_the_paper_come_with_their_models(models, model_folder, name, kind):
    detector, sha256 = load_detector(name, "paper", model_folder, FITS)
    assert isinstance(detector, kind)
    assert sha256 == models[f"{name}-paper"].sha256


@pytest.mark.parametrize(
    ("options", "message"), [({"sigma": 1.0}, "has no option sigma"), ({"features": "all"}, "code, p")]
)
def test_options_that_are_none_are_refused(model_folder, options, message):
    with pytest.raises(BadInputError, match=message):
        load_detector("gaussian", "paper", model_folder, FITS, options=options)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "gausian",
            r"not known \(did you mean 'gaussian'\?\); allowed: acceptance, .*, or package:Class",
        ),
        ("no_such_package:Detector", "cannot be imported"),
        ("json:NoSuchClass", "cannot be imported"),
        ("fractions:Fraction", "lacks start, check, accept"),
        ("mavfi.detectors:Detector", "lacks check; allowed: with check"),
        (
            f"{__name__}:Foreign",
            rf"detector {__name__}:Foreign: allowed: an object whose class inherits mavfi.Detector",
        ),
        (":", "not known"),
    ],
)
def test_what_is_no_detector_is_refused_in_one_line(name, message):
    with pytest.raises(BadInputError, match=message) as error:
        load_detector(name, "paper", None, FITS)
    assert "\n" not in str(error.value)


def test_profiles_and_models_that_are_not_there_are_named(model_folder, tmp_path):
    with pytest.raises(BadInputError, match="profile 'best': not known; allowed: paper, tuned"):
        load_detector("gaussian", "best", model_folder, FITS)
    with pytest.raises(BadInputError, match=r"gaussian-paper\.json: no model is trained"):
        load_detector("gaussian", "paper", tmp_path, FITS)
    with pytest.raises(BadInputError, match=r"^published-none-gaussian-paper\.json: no model"):  # not where it would be
        load_detector("gaussian", "paper", None, {**FITS, "platform": "none"})
    with pytest.raises(SpecMismatchError, match=r"trained for v_max 3\.0, used with v_max 5\.0"):
        load_detector("gaussian", "paper", model_folder, {**FITS, "v_max": 5.0})


def test_a_model_of_other_flights_is_used_where_it_is_named(model_folder, tmp_path):
    other = {**FITS, "platform": "slow", "planner": "rrt", "v_max": 5.0}
    model = load_detector("gaussian", "paper", model_folder, FITS)[1]
    assert load_detector("gaussian", "paper", model_folder, other, trained_for="published/i9-9940x")[1] == model
    with pytest.raises(BadInputError, match="'hardened/none': not known"):
        load_detector("gaussian", "paper", None, FITS, trained_for="hardened/none")
    with pytest.raises(SpecMismatchError, match="or fly with this one, key trained_for: published/i9-9940x"):
        load_detector("gaussian", "paper", model_folder, {**FITS, "planner": "rrt"})
    renamed = model_folder / "published-i9-9940x-gaussian-paper.json"
    (tmp_path / "hardened-slow-gaussian-paper.json").write_bytes(renamed.read_bytes())
    with pytest.raises(SpecMismatchError, match="trained for stack 'published', used with stack 'hardened'"):
        load_detector("gaussian", "paper", tmp_path, FITS, trained_for="hardened/slow")
    tuned = model_folder / "published-i9-9940x-gaussian-tuned.json"
    (tmp_path / renamed.name).write_bytes(tuned.read_bytes())
    with pytest.raises(BadInputError, match="is a model gaussian-tuned; needed: gaussian-paper"):
        load_detector("gaussian", "paper", tmp_path, FITS)


class Foreign:
    """It has what a detector has, but is none."""

    def start(self): ...

    def check(self, state, time_us): ...

    def accept(self, state, time_us): ...


class Mine(NoDetector):
    """A detector of one's own, with the recovery that goes with it."""

    recovery = {"grain": "message", "answer_s": 0.5}  # noqa: RUF012 - as in the documentation


class Silent(NoDetector):
    """It says nothing about recovery."""


class Wrong(NoDetector):
    """A value of its recovery is none."""

    recovery = {"grain": "house"}  # noqa: RUF012


class Other(NoDetector):
    """It would fly elsewhere."""

    recovery = {"environment": "dense"}  # noqa: RUF012


def test_a_detector_of_ones_own_brings_its_recovery():
    name = f"{__name__}:Mine"
    assert mission_keys(name) == {"grain": "message", "same_twice": "limit", "answer_s": 0.5}
    assert mission_keys("nowhere:Mine") == mission_keys("gaussian") == {}
    assert mission_keys(NoDetector()) == {} and mission_keys(f"{__name__}:Silent") == OF_OWN
    chosen = with_keys_of(MissionSpec(answer_s=2.0), name)
    assert (chosen.grain, chosen.answer_s) == ("message", 2.0), "what is chosen stays"
    assert with_keys_of(MissionSpec(grain="stage"), name).grain == "stage", "a default, too"
    with pytest.raises(
        BadInputError,
        match=r"Wrong': recovery: key 'grain': 'house': not known; allowed: 'stage', 'kernel' or 'message'",
    ):
        with_keys_of(MissionSpec(), f"{__name__}:Wrong")
    assert with_keys_of(MissionSpec(), Mine()).grain == "message", "an object, too"
    with pytest.raises(BadInputError, match=r"Other': recovery: .*allowed: values of coupling, grain, "):
        mission_keys(f"{__name__}:Other")
    campaign = small(arms={"mine": {"detector": name, "answer_s": 1.0}}, host="local")
    assert resolve_campaign(campaign).arms[-1].overrides == {"same_twice": "limit", "grain": "message", "answer_s": 1.0}
