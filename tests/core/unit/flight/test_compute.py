import pytest

from mavfi.config import PlatformConfig, shipped
from mavfi.errors import BadInputError
from mavfi.flight.latencies import Latencies, latency, stage_latency
from mavfi.states import PPC_STAGES, Stage


@pytest.mark.parametrize(
    ("name", "expected"), [("i9-9940x", (289_000, 83_000, 460)), ("cortex-a57", (502_000, 248_000, 1_300))]
)
def test_stages_cost_what_the_definitions_say(name, expected):
    platform = shipped("platforms", PlatformConfig, name)
    assert tuple(stage_latency(platform, stage) for stage in PPC_STAGES) == expected


def test_what_runs_on_the_flight_controller_costs_nothing():
    platform = PlatformConfig(name="toy", latency_us={"point_cloud": 5, "octomap": 6, "collision_check": 7})
    assert latency(platform, "state_estimation") == 0
    assert Latencies(platform).of_recomputation("state_estimation", Stage.PERCEPTION, 0) == 0
    assert Latencies(platform).of_recomputation("octomap", Stage.PERCEPTION, 0) == 18


def test_a_kernel_that_the_platform_does_not_know_is_named():
    platform = PlatformConfig(name="toy", latency_us={"pid": 5})
    with pytest.raises(BadInputError, match="platform toy: key 'latency_us': no kernel 'octomap'; it has pid"):
        latency(platform, "octomap")


def test_jitter_is_a_function_of_seed_kernel_and_instant():
    platform = PlatformConfig(name="toy", latency_us={"pid": 1_000, "planner": 1_000})
    steps = [Latencies(platform, 7, 3.0).of_kernel("pid", now) for now in range(0, 20_000_000, 20_000)]
    assert steps[:3] == [1_113, 2_427, 1_893]
    assert 250 <= min(steps) < 270 and 3_980 < max(steps) <= 4_000
    assert sum(steps) / len(steps) == pytest.approx(2_125, abs=100)
    assert Latencies(platform, 8, 3.0).of_kernel("pid", 0) != steps[0]
    assert Latencies(platform, 7, 3.0).of_kernel("planner", 0) != steps[0]
