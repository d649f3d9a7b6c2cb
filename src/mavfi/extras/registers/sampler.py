"""Faults in registers of a live process: `faults` for each kind of register, at the next call of a function if given.

In a process that flies a mission, the instant of the injection is uniform over the golden flight.
Instruction, register and bit are drawn while the process is stopped, from the seed of the fault: fault i has seed
first_seed + i.
"""

from collections.abc import Mapping, Sequence

from mavfi.campaign.config import Campaign, RegisterSampling
from mavfi.campaign.samplers.sampler import Block, Draw, OwnMissions, Sampled, alternating
from mavfi.faults.fault import Fault, RegisterFault
from mavfi.faults.sampling import stream

PATIENCE_S = 20.0  # time limit for the process to reach the injection point (s)


class RegisterSampler(OwnMissions):
    """Draws one bit of a register that an instruction reads or writes."""

    def __init__(self, campaign: Campaign) -> None:
        assert isinstance(campaign.sampling, RegisterSampling)  # as `sampler_for` chooses
        self._campaign, self._sampling = campaign, campaign.sampling

    def blocks(self, environment: str) -> Sequence[Block]:
        """One block per kind of registers."""
        del environment
        return alternating(self._campaign, self._sampling.registers)

    def draw(self, draws: Sequence[Draw], environment: str, golden: Mapping[str, Sampled]) -> list[Fault | None]:
        """One fault per draw; None without a golden run for comparison."""
        return [self._fault(d.target, d.index, environment, golden) if "" in golden else None for d in draws]

    def null(self, index: int, seed: int, environment: str, golden: Mapping[str, Sampled]) -> Fault:
        """A fault with every step except the flip; kinds of registers alternate."""
        del seed
        kinds = self._sampling.registers
        return self._fault(kinds[index % len(kinds)], index, environment, golden, null=True)

    def _fault(
        self, registers: str, index: int, environment: str, golden: Mapping[str, Sampled], *, null: bool = False
    ) -> RegisterFault:  # fmt: skip
        sampling, seed = self._sampling, self._campaign.first_seed + index
        flown = golden[""].flight.record() if "" in golden else None
        length_us = 0 if flown is None else round(1e6 * flown.flight_time_s)  # 0: a process that flies no mission
        return RegisterFault(
            registers, sampling.access, sampling.symbol, walk=sampling.walk, timeout=PATIENCE_S, null=null, seed=seed,
            node="" if flown is None else str(flown.extra.get("node", "")),
            time_us=int(stream(seed, environment, registers).integers(length_us)) if length_us else 0,
        )  # fmt: skip
