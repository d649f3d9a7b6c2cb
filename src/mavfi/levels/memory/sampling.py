"""Faults in memory of a campaign."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field, model_validator

from mavfi.errors import BadInputError
from mavfi.faults.fault import NO_SITE, Fault
from mavfi.faults.plug_ins import plug_ins_of_spec
from mavfi.faults.sampling import stream
from mavfi.levels.campaign import SampledCampaign
from mavfi.levels.level import (
    NULL,
    Draw,
    Golden,
    Sampled,
    Sampler,
    Sampling,
    SiteGroup,
    check_distinct,
    check_strata,
    group_json,
)
from mavfi.levels.memory.exposure import Exposure, FaultDrawing, MemorySite, fly_exposed
from mavfi.levels.memory.fault import MemoryFault
from mavfi.levels.memory.request import kernels_with, refusal_of
from mavfi.states import WATCHING

if TYPE_CHECKING:
    from mavfi.flight.host import ArmSetup, MissionFlights


class MemorySampling(Sampling):
    """Faults in memory of kernels or detectors: one bit, uniform over bits and instants of a golden run."""

    level: Literal["memory"]
    kernels: tuple[str, ...] = Field((), description="whose memory; all kernels by default")
    share: Literal["exposure", "kernel"] = Field(
        "exposure", description="what `faults` counts: all bits together, most of which are maps, or each kernel"
    )
    groups: tuple[SiteGroup, ...] = Field((), description="instead: `faults` for each of these, e.g. planner.acted_seq")
    strata: dict[str, float] | None = Field(None, description="shares of the faults by bit class; whole words else")

    @model_validator(mode="after")
    def _consistent(self) -> "MemorySampling":
        """Check names of kernels, groups and strata."""
        check_distinct("sampling.kernels", self.kernels)
        check_distinct("sampling.groups", [group.name for group in self.groups])
        if self.strata is not None:
            check_strata(self.strata)
        if any(group.lifetime or group.strata for group in self.groups):
            raise ValueError("sampling.groups: keys lifetime and strata: allowed with faults in states")
        return self

    def to_json(self) -> dict[str, Any]:
        """See `Sampling.to_json`."""
        return group_json(self.model_dump(mode="json"))


class MemorySampler(Sampler):
    """Draws one bit of a word in the memory of a kernel or a detector.

    Faults in a detector are drawn from the golden run of its arm, and injected in that arm alone.

    Raises:
        BadInputError: The sampling names a target that is not part of the mission, or of one arm.
    """

    draws_together = False

    def __init__(self, campaign: SampledCampaign) -> None:
        super().__init__(campaign)
        spec = campaign.first_mission
        self._kernels = kernels_with(spec.localization)
        self._plug_ins = plug_ins_of_spec(spec)
        self._detectors = campaign.custom_detectors
        self._sites = self._find_targets()
        self.targets = dict.fromkeys(self._sites, self.sampling.strata or {"": 1.0})
        self.arms = {name: self._flown_in(sites) for name, sites in self._sites.items()}

    def _find_targets(self) -> dict[str, tuple[MemorySite, ...]]:
        """The sites of each target, in the order of the plan."""
        sampling = self.sampling
        if sampling.groups:
            return {group.name: tuple(map(self._site, group.sites)) for group in sampling.groups}
        sites = [self._site(kernel) for kernel in sampling.kernels or self._kernels]
        if sampling.share == "kernel":
            return {kernel: ((kernel, name),) for kernel, name in sites}
        return {"memory": tuple(sites)}

    def _site(self, text: str) -> MemorySite:
        """The site in a text "KERNEL.WORD", or of all words of a kernel."""
        kernel, _, name = text.partition(".")
        if kernel in (*self._kernels, *WATCHING):
            return kernel, name
        for plug_in in (*self._plug_ins, *self._detectors.values()):
            if plug_in.is_called(kernel):
                return plug_in.name, name
        names = [plug_in.name for plug_in in (*self._plug_ins, *self._detectors.values())]
        raise BadInputError(f"sampling: {refusal_of(kernel, (*self._kernels, *WATCHING, *names))}")

    def _flown_in(self, sites: tuple[MemorySite, ...]) -> str:
        """The arm in whose golden runs faults of a target are drawn; "" = the campaign's own mission."""
        arms: set[str] = set()
        for name, _ in sites:
            watching = [arm for arm, plug_in in self._detectors.items() if plug_in.name == name]
            if name in WATCHING:
                watching = [self.campaign.arm_with(name)]
            arms.update(watching or [""])
        if len(arms) != 1:
            raise BadInputError(f"sampling: {', '.join(name for name, _ in sites)}: allowed: targets of one arm")
        return arms.pop()

    def golden(
        self, arm: str, draws: Sequence[Draw], environment: str, flights: "MissionFlights", setup: "ArmSetup"
    ) -> Sampled:
        """Fly the golden run, and draw its faults."""
        if arm and not draws:
            return Sampled(flights.golden(arm))
        exposures: dict[tuple[str, str], Exposure] = {}
        for draw in draws:
            number = self.repetition(draw.index)
            random = stream(draw.seed, "memory", draw.target, environment, number)
            key = draw.target, draw.stratum
            exposure = exposures.setdefault(key, Exposure(self._sites[draw.target], draw.stratum))
            exposure.drawings.append(FaultDrawing(random, draw.seed))
        if self.campaign.nulls and not arm:
            seed = setup.scenario.seed
            all_kernels = Exposure(tuple((kernel, "") for kernel in self._kernels))
            all_kernels.drawings.append(FaultDrawing(stream(seed, "memory", NULL, environment), seed))
            exposures[NULL, ""] = all_kernels
        golden = fly_exposed(setup, list(exposures.values()))
        flights.register_golden(arm, golden)
        return Sampled(golden, faults={key: exposure.faults() for key, exposure in exposures.items()})

    def null(self, index: int, seed: int, environment: str, golden: Golden) -> Fault:
        """A fault with an empty mask, drawn from the memory of all kernels."""
        del index, environment
        fault = MemoryFault(self._kernels[0], "", time_us=NO_SITE, seed=seed)
        if "" in golden:
            drawn: Any = golden[""].faults[NULL, ""]
            fault = next(iter(drawn), fault)
        return replace(fault, bit=None)
