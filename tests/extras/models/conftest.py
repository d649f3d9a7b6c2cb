"""Readers of this extra, also where the installed package does not list them yet."""

import pytest

from mavfi.extras.models import aerialist, airframe, vehicles, worlds
from mavfi.sim import imported

VEHICLES = {
    "sdf": vehicles.sdf_vehicle,
    "urdf": vehicles.urdf_vehicle,
    "xacro": vehicles.xacro_vehicle,
    "xml": vehicles.mjcf_vehicle,
    "params": airframe.airframe_vehicle,
    imported.NO_EXTENSION: airframe.airframe_vehicle,
}

ENVIRONMENTS = {
    "sdf": worlds.sdf_environment,
    "xml": worlds.xml_environment,
    "plan": aerialist.plan_environment,
    "yaml": aerialist.yaml_environment,
}


@pytest.fixture(autouse=True)
def readers(monkeypatch):
    groups = {imported.VEHICLE_FILES: VEHICLES, imported.ENVIRONMENT_FILES: ENVIRONMENTS}
    monkeypatch.setattr(imported, "extensions", lambda group: groups[group])
