"""Faults in registers of a live process: `faults` for each kind of register, at the next call of a function if given.

In a process that flies a mission, the instant of the injection is uniform over the golden flight.
Instruction, register and bit are drawn while the process is stopped, from the seed of the fault: fault i has seed
first_seed + i.
"""

from collections.abc import Sequence
from typing import Any, Literal, NoReturn

from pydantic import Field, model_validator

from mavfi.errors import BadInputError
from mavfi.extras.registers.fault import ACCESSES, MAX_WALK, RegisterFault
from mavfi.faults.fault import Fault
from mavfi.faults.sampling import stream
from mavfi.levels.campaign import SampledCampaign
from mavfi.levels.level import Draw, Golden, Level, Sampler, Sampling, check_distinct, check_known

PATIENCE_S = 20.0
"""Time limit for the process to reach the injection point."""


class RegisterSampling(Sampling):
    """Faults in registers of a live process (hosts ros2_stack and firmware)."""

    level: Literal["register"]
    registers: tuple[Literal["general", "fp", "all"], ...] = Field(
        ("general", "fp"), min_length=1, description="kinds of registers; `faults` for each"
    )
    access: str = Field("either", description="a register that an instruction reads, or one that it has written")
    symbol: str = Field("", description="stop at the next call of this function; a part of its name that no other has")
    walk: int = Field(64, ge=1, le=MAX_WALK, description="instructions from the stop to the injection, at most")

    @model_validator(mode="after")
    def _consistent(self) -> "RegisterSampling":
        check_known("sampling.access", [self.access], ACCESSES)
        check_distinct("sampling.registers", self.registers)
        return self


class RegisterSampler(Sampler):
    """Draws one bit of a register that an instruction reads or writes."""

    alternates = True
    draws_together = False

    def __init__(self, campaign: SampledCampaign) -> None:
        super().__init__(campaign)
        self.targets = dict.fromkeys(self.sampling.registers, {"": 1.0})

    def draw(self, draws: Sequence[Draw], environment: str, golden: Golden) -> list[Fault | None]:
        """One fault per draw; None without a golden run for comparison."""
        if "" not in golden:
            return [None] * len(draws)
        return [self._fault(draw.target, draw.index, environment, golden) for draw in draws]

    def null(self, index: int, seed: int, environment: str, golden: Golden) -> Fault:
        """A fault with every step except the flip; kinds of registers alternate."""
        del seed
        kinds = self.sampling.registers
        return self._fault(kinds[index % len(kinds)], index, environment, golden, null=True)

    def _fault(
        self, registers: str, index: int, environment: str, golden: Golden, *, null: bool = False
    ) -> RegisterFault:
        """The fault with this number; in a process that flies no mission, from its start on."""
        sampling = self.sampling
        seed = self.campaign.first_seed + index
        node = ""
        time_us = 0
        if "" in golden:
            record = golden[""].flight.record()
            node = str(record.extra.get("node", ""))
            flight_time_us = round(1e6 * record.flight_time_s)
            if flight_time_us:
                time_us = int(stream(seed, environment, registers).integers(flight_time_us))
        return RegisterFault(
            registers,
            sampling.access,
            sampling.symbol,
            walk=sampling.walk,
            timeout=PATIENCE_S,
            null=null,
            seed=seed,
            node=node,
            time_us=time_us,
        )


class RegisterLevel(Level):
    """Faults in registers."""

    fault = RegisterFault
    sampling = RegisterSampling
    sampler = RegisterSampler

    def parse(self, text: str, localization: str) -> NoReturn:
        """Refuse all texts: a process is stopped by another command."""
        raise BadInputError("registers are injected by mavfi inject; allowed: state, memory, instruction, sensor")

    def columns(self, fault: RegisterFault) -> dict[str, Any]:
        """See `Level.columns`."""
        return {"register": fault.registers, "symbol": fault.symbol, "kernel": fault.node}

    def about(self, campaign: SampledCampaign) -> dict[str, Any]:
        """See `Level.about`."""
        return {"each": "kind of registers", "how": "uniform over the firmware's instructions"}
