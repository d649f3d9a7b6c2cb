"""Instruction faults of a campaign, distributed equally over kernels, or over stages and their kernels.

A mission's golden run counts the instructions of its kernels and draws the faults.  Faults in a planner other than the
campaign's are drawn in separate missions with that planner.  Faults in a detector are drawn from the golden run of its
arm, which counts kernels, recomputations included, and detector, and are injected in that arm alone.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from mavfi.campaign.config import Campaign, InstructionSampling
from mavfi.campaign.fingerprint import python
from mavfi.campaign.samplers.instruction import draw_instruction_faults
from mavfi.campaign.samplers.sampler import Block, Draw, Sampled, watched_in
from mavfi.errors import BadInputError
from mavfi.faults.fault import Fault
from mavfi.faults.sampling import share_out
from mavfi.faults.spec import InstructionRequest
from mavfi.hosts.host import ArmSetup, MissionFlights
from mavfi.hosts.local.mission_flights import LocalFlights
from mavfi.ir.digest import DIGEST_VERSION
from mavfi.states import DETECTORS, KERNEL_STAGES, PLANNERS, PPC_STAGES


class InstructionSampler:
    """Draws one result of one dynamic instruction.

    Raises:
        BadInputError: Arms and kernels are incompatible.
    """

    instruments = True

    def __init__(self, campaign: Campaign) -> None:
        assert isinstance(campaign.sampling, InstructionSampling)  # as `sampler_for` chooses
        self._campaign, self._sampling = campaign, campaign.sampling
        self.versions: Mapping[str, str] = {
            "python": python(),  # Numba compiles Python's bytecode, which determines the fault space
            "fault space": DIGEST_VERSION,
        }
        self._blocks: dict[str, Sequence[Block]] = {}
        planner = campaign.spec(campaign.environments[0], campaign.first_seed).planner
        others = [name for name in self._sampling.kernels if name in PLANNERS and name != planner]
        self.variants: Mapping[str, Mapping[str, Any]] = {name: {"planner": name} for name in others}
        if campaign.arms and others:
            raise BadInputError(
                f"sampling.kernels: {others[0]!r}: detectors are trained with one planner; allowed with arms: kernels "
                f"of missions with planner {planner!r}"
            )
        self._watched = {name: watched_in(campaign, name) for name in self._sampling.kernels if name in DETECTORS}
        _check_arms(campaign, self._sampling.kernels, {"planner": planner, "map": "octomap"})
        if campaign.nulls:
            raise BadInputError(f"null_runs: {campaign.nulls}; allowed: 0 with faults in instructions")

    def blocks(self, environment: str) -> Sequence[Block]:
        """One block per kernel or stage; the seed draws the kernels of a stage's faults."""
        if environment not in self._blocks:
            groups = kernel_groups(self._sampling)
            self._blocks[environment] = [self._block(environment, place, group) for place, group in enumerate(groups)]
        return self._blocks[environment]

    def _block(self, environment: str, place: int, group: tuple[str, ...]) -> Block:
        campaign, stage = self._campaign, str(KERNEL_STAGES.get(group[0], group[0]))
        kernels = share_out(dict.fromkeys(group, 1.0), campaign.faults, campaign.first_seed, environment, stage)

        def draw_one(index: int) -> Draw:
            seed = campaign.first_seed + index % campaign.missions
            return Draw(kernels[index], index, seed, self._flown_in(kernels[index]))

        return Block(campaign.faults, draw_one, place * campaign.faults)

    def _flown_in(self, kernel: str) -> str:
        """Variant or arm in whose golden runs faults of a kernel are drawn; "" = the campaign's own mission."""
        return self._watched.get(kernel, kernel if kernel in self.variants else "")

    def golden(
        self, arm: str, draws: Sequence[Draw], environment: str, flights: MissionFlights, setup: ArmSetup
    ) -> Sampled:  # fmt: skip
        """Fly the golden run with instruction counters, and draw its faults."""
        targets = [draw.target for draw in draws]
        places = {arm, ""} if arm in self._watched.values() else {arm}  # there kernels are counted, too
        kernels = [name for name in self._sampling.kernels if self._flown_in(name) in places]
        if not kernels:
            return Sampled(flights.golden(arm))
        sampling, scenario = self._sampling, setup.scenario
        request = InstructionRequest(
            {name: targets.count(name) for name in kernels}, sampling.which, sampling.model, sampling.restart_s,
            sampling=sampling.scheme,
        )  # fmt: skip
        drawn = draw_instruction_faults(
            scenario, request, environment, seed=scenario.seed, recovery=setup.recovery,
            detector=setup.detector(), flights=flights if isinstance(flights, LocalFlights) else None, arm=arm,
        )  # fmt: skip
        flights.know(arm, drawn.golden)
        return Sampled(drawn.golden, drawn.counts, {name: faults for name, faults in drawn.faults.items() if faults})

    def draw(self, draws: Sequence[Draw], environment: str, golden: Mapping[str, Sampled]) -> list[Fault | None]:
        """The faults drawn by `golden`, in order; None for each fault of a failed golden run."""
        del environment
        waiting = {(arm, kernel): iter(own) for arm, found in golden.items() for kernel, own in found.faults.items()}
        return [next(waiting.get((d.variant, d.target), iter(())), None) for d in draws]

    def null(self, index: int, seed: int, environment: str, golden: Mapping[str, Sampled]) -> Fault:
        """Not supported at this level."""
        raise BadInputError("null runs: allowed with faults in states")


def _check_arms(campaign: Campaign, drawn: Sequence[str], kernels: Mapping[str, str]) -> None:
    """Refuse an arm that replaces functions with drawn faults, which would never be activated there.

    `kernels`: the kernel whose functions change, by mission key.
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
    """Kernels that share one number of faults: each kernel separately, or the kernels of each stage."""
    if sampling.share == "kernel":
        return [(name,) for name in sampling.kernels]
    stages = [tuple(name for name in sampling.kernels if KERNEL_STAGES.get(name) is stage) for stage in PPC_STAGES]
    return [group for group in (*stages, *((name,) for name in sampling.kernels if name in DETECTORS)) if group]
