"""The tables from which the rest is derived: states, monitored sets, entry points, shipped configurations."""

import tomllib
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np
import pytest

from mavfi import config
from mavfi.detectors.gate import SOURCE as GATE
from mavfi.detectors.registry import (
    DetectorConfig,
    contains,
    detector_names,
    of_monitored_fields,
    trainable,
)
from mavfi.plugins import Chapter
from mavfi.states import AUTOPILOTS, MONITORED_SETS, PPC_STAGES, STATES, Stage
from tests.core.architecture.source import ROOT

UNITS = {"m", "m/s", "m/s^2", "rad", "rad/s", "s", "-"}
MODELS = {
    "environments": config.EnvironmentConfig,
    "autopilots": config.AutopilotConfig,
    "platforms": config.PlatformConfig,
    "vehicles": config.VehicleConfig,
    "planners": config.PlannerConfig,
    "detectors": DetectorConfig,
}
DECLARED = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["entry-points"]
SHIPPED = {
    "mavfi.environments": "mavfi.sim.environments.registry:_BUILT_IN",
    "mavfi.planners": "mavfi.pipeline.planners:_SHIPPED",
    "mavfi.flight_controllers": "mavfi.sim.controller:_SHIPPED",
    "mavfi.maps": "mavfi.pipeline.maps:_SHIPPED",
    "mavfi.hosts": "mavfi.flight.host:SHIPPED",
    "mavfi.levels": "mavfi.faults.fault:SHIPPED",
    "mavfi.detectors": "mavfi.detectors.registry:_SHIPPED",
}
"""Where the core's own names of a group are, found without the metadata of an installation."""
INTERNAL = {"mavfi.detectors": {"none"}}
"""Names without an entry point: the absence of a detector."""


def shipped():
    return [(kind, name) for kind in MODELS for name in config.names(kind)]


@pytest.mark.parametrize("state", STATES.values(), ids=STATES)
def test_every_field_of_a_state_has_a_unit_and_a_type_that_can_be_struck(state):
    assert state.fields
    for field in state.fields:
        assert field.unit in UNITS, field.name
        assert field.dtype in ("f8", "f4", "i4", "?"), field.name
        assert set(field.read_in) <= set(AUTOPILOTS), field.name


@pytest.mark.parametrize("state", STATES.values(), ids=STATES)
def test_a_state_is_named_after_its_stage(state):
    assert state.name.split(".")[0] == state.stage
    assert state.writer and state.rate


@pytest.mark.parametrize("state", STATES.values(), ids=STATES)
def test_the_float64_fields_of_a_header_come_first(state):
    kinds = [field.dtype == "f8" for field in state.header]
    assert kinds == sorted(kinds, reverse=True)
    assert state.header_dtype.itemsize == sum(np.dtype(field.dtype).itemsize for field in state.header)


def test_a_state_acts_on_a_counter_that_it_has():
    for state in STATES.values():
        assert not state.acted_on or state.find(state.acted_on).dtype == "i4"


def test_every_stage_of_the_paper_publishes_something():
    assert {state.stage for state in STATES.values()} == {Stage.SENSOR, *PPC_STAGES}


def test_monitored_sets_have_the_sizes_in_their_names_and_fields_that_exist():
    for name, fields in MONITORED_SETS.items():
        assert len(fields) == len(set(fields)) == int(name.split("-")[1])
        for state, field in fields:
            STATES[state].find(field)


@pytest.mark.parametrize("group", SHIPPED)
def test_entry_points_are_those_that_are_shipped(group):
    module, _, name = SHIPPED[group].partition(":")
    shipped_here = dict(getattr(import_module(module), name))
    for internal in INTERNAL.get(group, ()):
        del shipped_here[internal]
    of_core = {name: target for name, target in DECLARED[group].items() if not target.startswith("mavfi.extras.")}
    assert of_core.items() <= shipped_here.items() <= DECLARED[group].items()


@pytest.mark.parametrize("group", DECLARED)
def test_entry_points_resolve(group):
    points = list(entry_points(group=group))
    assert points
    for point in points:
        target = point.load()
        kinds = (Chapter, Path)  # Path: the folder of a template
        assert callable(target) or isinstance(target, kinds) or hasattr(target, "check_flown"), point.name


@pytest.mark.parametrize(("kind", "name"), shipped(), ids=lambda value: value)
def test_shipped_configurations_load_and_are_named_as_their_files(kind, name):
    assert config.shipped(kind, MODELS[kind], name).name == name


def test_what_the_paper_flew_is_shipped():
    assert {"factory", "farm", "sparse", "dense", "clutter"} <= set(config.names("environments"))
    assert {"i9-9940x", "cortex-a57"} <= set(config.names("platforms"))
    assert set(AUTOPILOTS) == set(config.names("autopilots"))
    assert {"rrt", "rrt_connect", "rrt_star"} == set(config.names("planners"))


def test_detectors_that_learn_are_entry_points_with_a_file_each():
    assert list(of_monitored_fields()) == ["gaussian", "autoencoder"]
    assert {*trainable(), "recommended"} <= set(config.names("detectors")) <= set(detector_names())
    assert all(contains(name, "tuned", GATE) for name in of_monitored_fields())


@pytest.mark.parametrize("name", config.names("environments"))
def test_environments_name_a_generator_and_a_vehicle_that_exist(name):
    environment = config.shipped("environments", config.EnvironmentConfig, name)
    assert environment.generator in entry_points(group="mavfi.environments").names
    assert environment.vehicle in config.names("vehicles")
