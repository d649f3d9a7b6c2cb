"""Faults in registers of a live process: `faults` for each kind of register, at the next call of a function if named.

Instruction, register and bit are drawn when the process has been stopped, from the seed of the fault: fault i has seed
first_seed + i.
"""

import functools
from collections.abc import Mapping, Sequence
from typing import Any

from mavfi.campaign.config import Campaign, RegisterSampling
from mavfi.campaign.samplers.sampler import Block, Draw, Sampled
from mavfi.faults.fault import Fault, RegisterFault
from mavfi.hosts.host import ArmSetup, MissionFlights

PATIENCE_S = 20.0  # how long the process may take to come by (s)


class RegisterSampler:
    """Draws one bit of a register that an instruction reads or writes."""

    variants: Mapping[str, Mapping[str, Any]] = {}
    versions: Mapping[str, str] = {}

    def __init__(self, campaign: Campaign) -> None:
        assert isinstance(campaign.sampling, RegisterSampling)  # as `sampler_for` chooses
        self._campaign, self._sampling = campaign, campaign.sampling

    def blocks(self, environment: str) -> Sequence[Block]:
        """Kinds of registers in turn."""
        del environment
        kinds = self._sampling.registers
        return [
            Block(self._campaign.faults, functools.partial(self._draw, registers), place, len(kinds))
            for place, registers in enumerate(kinds)
        ]

    def _draw(self, registers: str, index: int) -> Draw:
        return Draw(registers, index, self._campaign.first_seed + index % self._campaign.missions)

    def golden(
        self, arm: str, draws: Sequence[Draw], environment: str, flights: MissionFlights, setup: ArmSetup
    ) -> Sampled:  # fmt: skip
        """The golden run, with which trials are compared; nothing is drawn from it."""
        del draws, environment, setup
        return Sampled(flights.golden(arm))

    def draw(self, draws: Sequence[Draw], environment: str, golden: Mapping[str, Sampled]) -> list[Fault | None]:
        """One fault each; none where there is no golden run to compare with."""
        del environment
        return [self._fault(d.target, d.index) if "" in golden else None for d in draws]

    def null(self, index: int, seed: int, environment: str, golden: Mapping[str, Sampled]) -> Fault:
        """Everything but the flip, with each kind of registers in turn."""
        del seed, environment, golden
        kinds = self._sampling.registers
        return self._fault(kinds[index % len(kinds)], index, null=True)

    def _fault(self, registers: str, index: int, *, null: bool = False) -> RegisterFault:
        sampling = self._sampling
        return RegisterFault(
            registers, sampling.access, sampling.symbol, walk=sampling.walk, timeout=PATIENCE_S, null=null,
            seed=self._campaign.first_seed + index,
        )  # fmt: skip
