"""`KERNELS` says the same as the pipeline, the platforms, the states and the table of functions."""

from dataclasses import fields, replace
from itertools import chain

import pytest

from mavfi import config as configuration
from mavfi.config import PlatformConfig, shipped
from mavfi.flight.latencies import latency, stage_latency
from mavfi.kernels.perception.state_estimation import Noise
from mavfi.pipeline.functions import KernelFunctions
from mavfi.pipeline.ppc import build_pipeline
from mavfi.states import (
    INJECTABLE,
    INJECTED_KERNEL,
    KERNELS,
    ODOMETRY,
    PPC_STAGES,
    STATES,
    Stage,
    in_node,
    states_with,
)
from tests.core.unit.pipeline.parts import config

NOISE = Noise(0.1, 0.01, 0.001, 0.0001, 0.05, 0.02)


@pytest.fixture(scope="module", params=ODOMETRY)
def built(request):
    """Localization, and the pipeline that it needs."""
    noise = NOISE if request.param == "estimator" else None
    return request.param, build_pipeline(replace(config(), noise=noise))


def test_the_pipeline_has_the_kernels_of_the_table_in_its_order(built):
    localization, pipeline = built
    assert list(pipeline) == [name for name, spec in KERNELS.items() if spec.only_with in ("", localization)]
    for name, kernel in pipeline.items():
        assert (kernel.name, kernel.stage) == (name, KERNELS[name].stage)


def test_kernels_write_the_states_whose_writer_they_are(built):
    localization, pipeline = built
    published = states_with(localization)
    for kernel in pipeline.values():
        written_states = {name for name, spec in published.items() if spec.writer == kernel.name}
        assert set(kernel.writes) == written_states and written_states
        assert {STATES[name].stage for name in written_states} == {kernel.stage}
    written = set(chain.from_iterable(kernel.writes for kernel in pipeline.values()))
    assert set(published) - written == {name for name, spec in published.items() if spec.stage is Stage.SENSOR}


@pytest.mark.parametrize("name", configuration.names("platforms"))
def test_platforms_charge_the_kernels_of_the_table(name):
    platform = shipped("platforms", PlatformConfig, name)
    assert set(platform.latency_us) == {name for name, spec in KERNELS.items() if not spec.on_flight_controller}
    for kernel, spec in KERNELS.items():
        assert latency(platform, kernel) == platform.latency_us.get(kernel, 0)
        if not spec.counts:
            assert latency(platform, kernel) == 0, "what is no part of its stage's latency has none"
    for stage in PPC_STAGES:
        assert stage_latency(platform, stage) == sum(
            platform.latency_us[kernel] for kernel in platform.latency_us if KERNELS[kernel].stage is stage
        )


def test_nodes_partition_the_kernels():
    for name, spec in KERNELS.items():
        assert name in in_node(name)
        assert all(KERNELS[other].node == spec.node and in_node(other) == in_node(name) for other in in_node(name))
    assert in_node("trajectory") == in_node("planner") == ("planner", "trajectory")


def test_every_function_that_a_host_can_swap_belongs_to_one_kernel():
    attributes = [field.name for field in fields(KernelFunctions)]
    named = list(dict.fromkeys(chain.from_iterable(INJECTABLE.values())))
    assert sorted(named) == sorted(attributes)
    owners = {name: {INJECTED_KERNEL[kernel] for kernel in INJECTABLE if name in INJECTABLE[kernel]} for name in named}
    assert all(len(kernels) == 1 for kernels in owners.values())
