"""The schemas of campaigns and studies are those of the models, and all shipped files fit them."""

import json
from pathlib import Path

import pytest

from mavfi.cli.init import DATA, SCHEMAS
from mavfi.config import config_root, read_yaml
from tools.build_schemas import schemas
from tools.markers import ROOT

jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed")
FILES = {
    "campaign": [
        *(config_root() / "campaigns").glob("*.yaml"),
        *(DATA / "templates").glob("*/campaign.yaml"),
        ROOT / "src/mavfi/extras/ros/templates/node/campaign.yaml",
        ROOT / "examples/ros2/limiter.yaml",
        ROOT / "examples/airsim/box.yaml",
        ROOT / "examples/own_kernels/table1.yaml",
    ],
    "study": [*(config_root() / "studies").glob("*.yaml")],
}


def validator(name):
    return jsonschema.Draft202012Validator(json.loads((SCHEMAS / f"{name}.json").read_text()))


def test_schemas_are_up_to_date():
    for path, content in schemas().items():
        assert path.read_text() == content, f"{path.name}: run `make docs`"


@pytest.mark.parametrize("name", FILES)
def test_shipped_files_fit(name):
    assert len(FILES[name]) >= 2
    for path in FILES[name]:
        errors = [
            f"{path.name}: {error.json_path}: {error.message}"
            for error in validator(name).iter_errors(read_yaml(Path(path)))
        ]
        assert not errors


@pytest.mark.parametrize(
    "change",
    [
        {"environmnts": ["sparse"]},
        {"mission": {"plannr": "rrt"}},
        {"arms": {"a": {"detecor": "x"}}},
        {"missions": "ten"},
    ],
)
def test_a_mistake_does_not_fit(change):
    smoke = read_yaml(config_root() / "campaigns" / "smoke.yaml")
    assert list(validator("campaign").iter_errors({**smoke, **change}))
