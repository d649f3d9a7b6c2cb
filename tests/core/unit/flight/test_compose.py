"""What a mission's files name, and what is said if it does not exist."""

import pytest

from mavfi.errors import BadInputError
from mavfi.flight.compose import resolve
from mavfi.mission import MissionSpec


@pytest.mark.parametrize(
    ("key", "text", "message"),
    [
        ("planner", "name: foo", "key 'name': planner 'foo': not known"),
        ("environment", "name: mine\ngenerator: swamp", "key 'generator': generator 'swamp': not known"),
        ("environment", "name: mine\ngenerator: no_such:world", "key 'generator': generator 'no_such:world': named in"),
        ("environment", "name: mine\ngenerator: farm\nvehicle: kite", "key 'vehicle': vehicle 'kite': not known"),
    ],
)
def test_a_value_of_a_file_is_refused_with_file_and_key(tmp_path, monkeypatch, key, text, message):
    monkeypatch.setenv("MAVFI_ALLOW_PLUGINS", "")
    path = tmp_path / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(BadInputError) as caught:
        resolve(MissionSpec(**{key: str(path)}))
    assert str(caught.value).startswith(f"{path}: {message}")
