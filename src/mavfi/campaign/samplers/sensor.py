"""Failures of sensors and motors: `faults` for each unit, its types in equal shares.

The start is uniform over the golden flight; of several motors, the number is uniform.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from mavfi.campaign.config import Campaign
from mavfi.campaign.samplers.sampler import Block, Draw, OwnMissions, Sampled, TargetBlocks
from mavfi.campaign.sampling import SensorSampling
from mavfi.errors import BadInputError
from mavfi.faults.fault import NO_SITE, Fault
from mavfi.faults.levels.sensor.fault import NULL, UNITS, SensorFault
from mavfi.faults.sampling import stream
from mavfi.faults.spec import SensorRequest
from mavfi.flight.sensor_faults import check_read
from mavfi.mission import MissionSpec


class SensorSampler(OwnMissions):
    """Draws the start of a failure, and of several motors one.

    Raises:
        BadInputError: The sampling names a unit that nothing in the mission reads.
    """

    def __init__(self, campaign: Campaign) -> None:
        assert isinstance(campaign.sampling, SensorSampling)  # as `sampler_for` chooses
        self._campaign, self._sampling = campaign, campaign.sampling
        mission = campaign.spec(campaign.environments[0], campaign.first_seed)
        self._units = self._sampling.units or tuple(unit for unit in UNITS if _is_read(unit, mission))
        if campaign.program is None:
            for unit in self._units:
                check_read(unit, mission.flight_controller, mission.localization)
        self._blocks = TargetBlocks(campaign, dict.fromkeys(self._units, dict.fromkeys(self._sampling.types, 1.0)))

    def blocks(self, environment: str) -> Sequence[Block]:
        """One block per unit."""
        return self._blocks.of(environment)

    def draw(self, draws: Sequence[Draw], environment: str, golden: Mapping[str, Sampled]) -> list[Fault | None]:
        """One failure per draw; None without a golden run."""
        if "" not in golden:
            return [None] * len(draws)
        return [self._fault(d.target, d.stratum, d.index, d.seed, environment, golden) for d in draws]

    def null(self, index: int, seed: int, environment: str, golden: Mapping[str, Sampled]) -> Fault:
        """A fault that changes nothing; units alternate."""
        return self._fault(self._units[index % len(self._units)], NULL, index, seed, environment, golden)

    def _fault(
        self, unit: str, kind: str, index: int, seed: int, environment: str, golden: Mapping[str, Sampled]
    ) -> SensorFault:  # fmt: skip
        address = environment, index // self._campaign.missions
        most = UNITS[unit].instances
        instance = 1 + int(stream(seed, "instance", unit, *address).integers(most)) if most > 1 else 0
        planned = SensorFault(unit, kind, lasts_s=float(self._sampling.lasts_s), instance=instance)
        length_us = round(1e6 * golden[""].flight.record().flight_time_s) if "" in golden else 0
        if not length_us:
            return replace(planned, time_us=NO_SITE, seed=seed)
        return SensorRequest(planned, drawn=True).resolve(seed, length_us, *address)


def _is_read(unit: str, mission: MissionSpec) -> bool:
    """Whether something in a mission reads a unit."""
    try:
        check_read(unit, mission.flight_controller, mission.localization)
    except BadInputError:
        return False
    return True
