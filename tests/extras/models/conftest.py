"""Readers of this extra, also where the installed package does not list them yet."""

import pytest

from mavfi.extras.models import airframe, vehicles
from mavfi.sim import imported

VEHICLES = {
    "sdf": vehicles.sdf_vehicle,
    "urdf": vehicles.urdf_vehicle,
    "xacro": vehicles.xacro_vehicle,
    "xml": vehicles.mjcf_vehicle,
    "params": airframe.airframe_vehicle,
    imported.NO_EXTENSION: airframe.airframe_vehicle,
}


@pytest.fixture(autouse=True)
def readers(monkeypatch):
    groups = {imported.VEHICLE_FILES: VEHICLES}
    monkeypatch.setattr(imported, "extensions", lambda group: groups[group])
