from dataclasses import replace

import pytest

from mavfi.detectors.model import Model, check_fits
from mavfi.errors import BadInputError, SpecMismatchError

ORIGIN = {"stack": "published", "platform": "i9-9940x", "v_max": 3.0, "planner": "rrt_connect"}
MODEL = Model("gaussian", "paper", "paper-13", "interval", {"statistics": [[1.0, 0.1, 1 / 3]]}, ORIGIN)


def test_a_model_survives_the_disk(tmp_path):
    path = MODEL.save(tmp_path / "new")
    assert path.name == "published-i9-9940x-gaussian-paper.json"
    assert Model.load(path) == MODEL
    assert Model.load(path).sha256 == MODEL.sha256


def test_a_changed_model_is_refused(tmp_path):
    path = MODEL.save(tmp_path)
    Model.load(path)
    path.write_text(path.read_text().replace("0.1", "0.2"))
    with pytest.raises(BadInputError, match=r"paper\.json: the content does not match its sha256"):
        Model.load(path)


@pytest.mark.parametrize("key", ["parameters", "provenance", "kind"])
def test_every_part_is_in_the_hash(key):
    changed = {"parameters": {}, "provenance": {**ORIGIN, "seeds": [1, 2]}, "kind": "other"}
    assert replace(MODEL, **{key: changed[key]}).sha256 != MODEL.sha256


@pytest.mark.parametrize("content", ["", "[1]", "{}", '{"format": 99}', "\x00"])
def test_what_is_no_model_is_refused_in_one_line(tmp_path, content):
    path = tmp_path / "x.json"
    path.write_text(content)
    with pytest.raises(BadInputError) as error:
        Model.load(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)
    with pytest.raises(BadInputError, match="cannot be read"):
        Model.load(tmp_path / "absent.json")


def test_a_model_is_used_only_where_it_was_trained_for():
    check_fits(MODEL, **ORIGIN)
    for key, value in {"stack": "hardened", "platform": "cortex-a57", "v_max": 5.0, "planner": "rrt"}.items():
        with pytest.raises(SpecMismatchError, match=f"trained for {key} .*, used with {key} {value!r}"):
            check_fits(MODEL, **{**ORIGIN, key: value})
