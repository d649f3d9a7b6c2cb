"""Missions with a vehicle and a world of another simulator, from the command line."""

import json

import pytest

from mavfi.cli import run
from tests.extras.models import models
from tests.extras.models.test_worlds import GROUND, sdf_box, sdf_file


@pytest.mark.slow
def test_a_model_flies_around_a_wall(tmp_path, capsys):
    (tmp_path / "quad.sdf").write_text(models.sdf(), encoding="utf-8")
    wall = sdf_file(tmp_path, GROUND, sdf_box("wall", "10 0 4 0 0 0.3", "1 8 10"))
    ends = ["--start", "0", "0", "3", "--goal", "20", "0", "3"]
    with pytest.warns(UserWarning) as warnings_:
        code = run(["fly", "--seed", "7", "--environment", wall, "--vehicle", f"{tmp_path}/quad.sdf", *ends, "--json"])
    flight = json.loads(capsys.readouterr().out)
    assert code == 0 and flight["status"] == "success" and flight["vehicle"] == "quad"
    texts = [str(warning.message) for warning in warnings_]
    assert any("walls.sdf: obstacles: 1, as " in text for text in texts)
    assert any("quad.sdf: flown as quad with mass 2.2" in text for text in texts)
