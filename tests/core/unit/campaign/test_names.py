import pytest

from mavfi.campaign.begin import check_names
from mavfi.errors import BadInputError
from mavfi.plugins import NotAllowedError
from tests.core.unit.campaign.fakes import small

GROUND = "the_ground:Host"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"host": "mars"}, "key 'host': 'mars': not known; allowed: "),
        (
            {"environments": ["sparse", "spars"]},
            "key 'environments': 'spars': not known (did you mean 'sparse'?); allow",
        ),
        (
            {"environments": ["fast"], "parts": {"fast": {"environment": "dense", "platform": "i8"}}},
            "key 'parts.fast.platform': 'i8': not known; allowed: ",
        ),
        (
            {"arms": {"x": {"detector": "gausian"}}},
            "'arms.x.detector': 'gausian': not known (did you mean 'gaussian'?)",
        ),
    ],
)
def test_a_name_that_does_not_exist_is_refused_with_its_file_and_key(changes, message):
    with pytest.raises(BadInputError) as caught:
        check_names(small(**changes), "mine.yaml")
    assert str(caught.value).startswith("mine.yaml: ")
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_code_that_is_not_allowed_remains_so(monkeypatch):
    monkeypatch.delenv("MAVFI_ALLOW_PLUGINS", raising=False)
    with pytest.raises(NotAllowedError, match=f"^mine.yaml: key 'host': '{GROUND}': named in a file, and so not run"):
        check_names(small(host=GROUND), "mine.yaml")
