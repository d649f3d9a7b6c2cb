import pytest

from mavfi import config
from mavfi.extras.paper.failure_rate import UpsetConfig
from mavfi.extras.paper.redundancy import DesignConfig

MODELS = {"redundancy": DesignConfig, "upsets": UpsetConfig}


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind in MODELS for name in config.names(kind)])
def test_shipped_configurations_load_and_are_named_as_their_files(kind, name):
    assert config.shipped(kind, MODELS[kind], name).name == name
