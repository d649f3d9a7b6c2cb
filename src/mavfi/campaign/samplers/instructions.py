"""Faults in instructions of a campaign: kernels, or the kernels of stages, share them equally.

A mission's golden run counts what its kernels execute, and draws.  A kernel of a planner that the campaign does not fly
has missions of its own, flown with that planner.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from mavfi.campaign.config import Campaign, InstructionSampling
from mavfi.campaign.fingerprint import python
from mavfi.campaign.samplers.instruction import draw_instruction_faults
from mavfi.campaign.samplers.sampler import Block, Draw, Sampled
from mavfi.errors import BadInputError
from mavfi.faults.fault import Fault
from mavfi.faults.sampling import share_out
from mavfi.faults.spec import InstructionRequest
from mavfi.hosts.host import ArmSetup, MissionFlights
from mavfi.states import KERNEL_STAGES, PLANNERS, PPC_STAGES


class InstructionSampler:
    """Draws one result of one dynamic instruction.

    Raises:
        BadInputError: Arms and kernels do not go together.
    """

    def __init__(self, campaign: Campaign) -> None:
        assert isinstance(campaign.sampling, InstructionSampling)  # as `sampler_for` chooses
        self._campaign, self._sampling = campaign, campaign.sampling
        self.versions: Mapping[str, str] = {
            "python": python()
        }  # Numba compiles its bytecode, which decides what can be injected into
        self._blocks: dict[str, Sequence[Block]] = {}
        planner = campaign.spec(campaign.environments[0], campaign.first_seed).planner
        others = [name for name in self._sampling.kernels if name in PLANNERS and name != planner]
        self.variants: Mapping[str, Mapping[str, Any]] = {name: {"planner": name} for name in others}
        if campaign.arms and others:
            raise BadInputError(
                f"sampling.kernels: {others[0]!r}: detectors are trained with one planner; allowed with arms: kernels "
                f"of missions with planner {planner!r}"
            )
        _check_arms(campaign, self._sampling.kernels, {"planner": planner, "map": "octomap"})
        if campaign.nulls:
            raise BadInputError(f"null_runs: {campaign.nulls}; allowed: 0 with faults in instructions")

    def blocks(self, environment: str) -> Sequence[Block]:
        """Kernel by kernel; where stages share, the seed draws which number falls to which kernel of a stage."""
        if environment not in self._blocks:
            groups = enumerate(kernel_groups(self._sampling))
            self._blocks[environment] = [self._block(environment, *group) for group in groups]
        return self._blocks[environment]

    def _block(self, environment: str, place: int, group: tuple[str, ...]) -> Block:
        campaign, stage = self._campaign, KERNEL_STAGES[group[0]].value
        kernels = share_out(dict.fromkeys(group, 1.0), campaign.faults, campaign.first_seed, environment, stage)

        def draw_one(index: int) -> Draw:
            variant = kernels[index] if kernels[index] in self.variants else ""
            return Draw(kernels[index], index, campaign.first_seed + index % campaign.missions, variant)

        return Block(campaign.faults, draw_one, place * campaign.faults)

    def golden(
        self, arm: str, draws: Sequence[Draw], environment: str, flights: MissionFlights, setup: ArmSetup
    ) -> Sampled:  # fmt: skip
        """The golden run with counted instructions; its faults are drawn on the way."""
        targets = [draw.target for draw in draws]
        kernels = [name for name in self._sampling.kernels if (name if name in self.variants else "") == arm]
        if not kernels:
            return Sampled(flights.golden(arm))
        sampling, scenario = self._sampling, setup.scenario
        request = InstructionRequest(
            {name: targets.count(name) for name in kernels}, sampling.which, sampling.model, sampling.restart_s,
            sampling=sampling.scheme,
        )  # fmt: skip
        drawn = draw_instruction_faults(scenario, request, environment, seed=scenario.seed)
        flights.know(arm, drawn.golden)
        return Sampled(drawn.golden, drawn.counts, drawn.faults)

    def draw(self, draws: Sequence[Draw], environment: str, golden: Mapping[str, Sampled]) -> list[Fault | None]:
        """What was drawn in flight, in turn; a golden run that left nothing has drawn nothing."""
        del environment
        waiting = {kernel: iter(faults) for sampled in golden.values() for kernel, faults in sampled.faults.items()}
        return [next(waiting.get(d.target, iter(())), None) for d in draws]

    def null(self, index: int, seed: int, environment: str, golden: Mapping[str, Sampled]) -> Fault:
        """There are none."""
        raise BadInputError("null runs: allowed with faults in states")


def _check_arms(campaign: Campaign, drawn: Sequence[str], kernels: Mapping[str, str]) -> None:
    """Refuse an arm that swaps the functions that faults are drawn from: there they would never be activated.

    `kernels`: the kernel that calls other functions, by key of the mission.
    """
    place = campaign.environments[0], campaign.first_seed
    for name, arm in campaign.arms.items():
        for key, kernel in kernels.items():
            base, own = (getattr(campaign.spec(*place, overrides), key) for overrides in (None, arm.mission))
            if own != base and kernel in drawn:
                raise BadInputError(
                    f"arms: {name!r}: {key}: {own!r}: does not call what faults in {kernel} are drawn from; allowed: "
                    f"{base!r}"
                )


def kernel_groups(sampling: InstructionSampling) -> list[tuple[str, ...]]:
    """Kernels that share one number of faults: each alone, or those of each stage."""
    if sampling.share == "kernel":
        return [(name,) for name in sampling.kernels]
    stages = [tuple(name for name in sampling.kernels if KERNEL_STAGES[name] is stage) for stage in PPC_STAGES]
    return [group for group in stages if group]
