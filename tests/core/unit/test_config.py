from typing import Literal

import pytest
from pydantic import Field, model_validator

from mavfi.config import (
    AutopilotConfig,
    Config,
    EnvironmentConfig,
    PlatformConfig,
    VehicleConfig,
    load,
    names,
    parse,
    shipped,
)
from mavfi.errors import BadInputError


class Wheel(Config):
    radius: float = Field(gt=0)


class Cart(Config):
    name: str
    wheel: Wheel
    wheels: int = Field(2, ge=1)


class Ship(Config):
    hull: Literal["wood", "steel"]
    masts: int = 0
    crew: tuple[str, ...] = ()
    sails: dict[str, tuple[float, ...]] = {}
    speed: float | Literal["inf"] | None = None
    afloat: bool = True
    armed: bool | None = None

    @model_validator(mode="after")
    def _floats(self) -> "Ship":
        if self.hull == "steel" and self.masts:
            raise ValueError(f"masts: {self.masts}: ships of steel have none")
        return self


GOOD = {"name": "a", "wheel": {"radius": 0.3}}


def refusal(data):
    with pytest.raises(BadInputError) as caught:
        parse(Cart, data, "cart.yaml")
    return str(caught.value)


def test_sound_data_become_a_frozen_model():
    cart = parse(Cart, GOOD, "cart.yaml")
    assert (cart.wheel.radius, cart.wheels) == (0.3, 2)
    with pytest.raises(ValueError, match="frozen"):
        cart.wheels = 3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"weels": 2}, "cart.yaml: unknown key 'weels' (did you mean 'wheels'?); allowed: name, wheel, wheels"),
        ({"wheel": {"radius": 1, "spokes": 8}}, "cart.yaml: unknown key 'wheel.spokes'; allowed: radius"),
        ({"wheels": 0}, "cart.yaml: key 'wheels': 0: allowed: 1 or more"),
        ({"wheel": {"radius": -1}}, "cart.yaml: key 'wheel.radius': -1: allowed: above 0"),
        ({"wheel": {"radius": float("nan")}}, "cart.yaml: key 'wheel.radius': nan: allowed: a finite number"),
        ({"wheel": {}}, "cart.yaml: key 'wheel.radius': is required"),
    ],
)
def test_bad_data_are_refused_in_one_line_that_names_key_value_and_what_is_allowed(change, message):
    assert refusal(GOOD | change) == message


@pytest.mark.parametrize(
    ("ship", "message"),
    [
        ({"hull": "steel", "masts": 2}, "masts: 2: ships of steel have none"),
        ({}, "key 'hull': is required; allowed: wood, steel"),
        ({"hull": "wax"}, "key 'hull': 'wax': not known; allowed: 'wood' or 'steel'"),
        ({"hull": "wood", "crew": {"a": 1}}, "key 'crew': keys with values: allowed: a list"),
        ({"hull": "wood", "masts": True}, "key 'masts': true: allowed: a whole number"),
        ({"hull": "wood", "speed": False}, "key 'speed': false: allowed: a number"),
        (
            {"hul": "wood"},
            "unknown key 'hul' (did you mean 'hull'?); allowed: hull, masts, crew, sails, speed, afloat, armed",
        ),
    ],
)
def test_messages_show_what_is_wrong_and_not_the_whole_mapping(ship, message):
    with pytest.raises(BadInputError) as caught:
        parse(Ship, ship, "ship.yaml")
    assert str(caught.value) == f"ship.yaml: {message}"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            "name: a\nwheels: [1\nwheel: {radius: 1}\n",
            r"bad.yaml:3:6: not a YAML file \(.*expected ',' or ']'",
        ),
        ("name: a\n\t- b\n", r"bad.yaml:2:1: not a YAML file \(found "),
        ("", "bad.yaml: is empty; allowed: keys with values"),
        ("just text", "bad.yaml: holds 'just text'; allowed: keys with values"),
        ("name: a\nwheels: 1\nname: b\n", r"not a YAML file \(key 'name' twice, again in line 3\)"),
        ("name: " + 5000 * "[" + "\n", "not a YAML file"),
        pytest.param("name: " + 100_000 * "[" + 100_000 * "]", "too long; allowed: 10,000 lists", id="lists"),
        pytest.param(100_000 * "{a: " + 100_000 * "}", "too long; allowed: 10,000 lists and mappings", id="mappings"),
        ("name: 2020-13-45\n", "not a YAML file"),
    ],
)
def test_a_file_that_holds_no_mapping_is_refused(tmp_path, content, message):
    path = tmp_path / "bad.yaml"
    with pytest.raises(BadInputError, match=r"bad.yaml: cannot be read \(No such file or directory\)"):
        load(Cart, path)
    path.write_text(content)
    with pytest.raises(BadInputError, match=message) as caught:
        load(Cart, path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


KINDS = {
    "environments": EnvironmentConfig,
    "autopilots": AutopilotConfig,
    "platforms": PlatformConfig,
    "vehicles": VehicleConfig,
}


@pytest.mark.parametrize("kind", ["autopilots", "platforms"])
def test_names_of_models_files_are_plain(kind):
    sound = shipped(kind, KINDS[kind], names(kind)[0]).model_dump()
    with pytest.raises(BadInputError, match=r"^x.yaml: key 'name': '../x': allowed: a plain folder name"):
        parse(KINDS[kind], {**sound, "name": "../x"}, "x.yaml")
    assert parse(KINDS[kind], {**sound, "name": "a b"}, "ledger", stored=True).name == "a b", "flown before"


def test_a_folder_and_a_similar_name_are_told_as_such(tmp_path):
    with pytest.raises(
        BadInputError, match=r"environment '.*': is a folder; allowed: .*, or a path to a .yaml, .bt or"
    ):
        shipped("environments", EnvironmentConfig, str(tmp_path), (".bt", ".ot"))
    with pytest.raises(BadInputError, match=r"'spars': not known \(did you mean 'sparse'\?\); allowed: clutter, dense"):
        shipped("environments", EnvironmentConfig, "spars")


def test_a_file_of_ones_own_is_read_by_path(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("name: mine\nlatency_us: {pid: 1}\n")
    assert shipped("platforms", PlatformConfig, str(path)).latency_us == {"pid": 1}
