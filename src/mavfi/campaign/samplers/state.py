"""Faults in inter-kernel states: `stage_balanced`, the paper's equal number per stage, groups of fields, or messages.

The shares of the bit strata are exact, their order is drawn from the seed; each fault has a separate random stream.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from mavfi.campaign.config import Campaign
from mavfi.campaign.samplers.sampler import Block, Draw, OwnMissions, Sampled, TargetBlocks
from mavfi.campaign.sampling import StateSampling
from mavfi.errors import BadInputError
from mavfi.faults.fault import Fault, StateFault
from mavfi.faults.sampling import Target, draw, draw_in_message, group_target, message_target, stage_target
from mavfi.faults.strata import HEADLINE, WORD_BITS, bits_of
from mavfi.record import Profile
from mavfi.states import PPC_STAGES, STATES


class StateSampler(OwnMissions):
    """Draws one bit of one field of one publication.

    Raises:
        BadInputError: A target has no bits in one of its strata.
    """

    profile = True

    def __init__(self, campaign: Campaign) -> None:
        assert isinstance(campaign.sampling, StateSampling)  # as `sampler_for` chooses
        spec = campaign.spec(campaign.environments[0], campaign.first_seed)
        self._campaign, self._sampling = campaign, campaign.sampling
        self._autopilot, self._localization = spec.autopilot, spec.localization
        self._targets = {target.name: (target, shares) for target, shares in self._find_targets()}
        self._lifetimes = {group.name: group.lifetime for group in self._sampling.groups if group.lifetime}
        self._alike = {name: self._first_alike(name) for name in self._targets}
        by_target = {name: shares for name, (_, shares) in self._targets.items()}
        self._blocks = TargetBlocks(campaign, by_target, self._alike)
        for target, shares in self._targets.values():
            for stratum in shares:
                target.within(stratum)

    def _find_targets(self) -> list[tuple[Target, Mapping[str, float]]]:
        sampling = self._sampling
        if sampling.scheme == "groups":
            return [(self._group(place), g.strata or sampling.strata) for place, g in enumerate(sampling.groups)]
        if sampling.scheme == "messages":
            return [self._message(state) for state in sampling.messages]
        monitored = self._campaign.monitored_set if sampling.sites == "monitored" else None
        return [
            (stage_target(stage, self._autopilot, monitored, self._localization), sampling.strata)
            for stage in PPC_STAGES
        ]

    def _group(self, place: int) -> Target:
        group = self._sampling.groups[place]
        try:
            return group_target(group.name, group.sites, self._localization)
        except BadInputError as error:
            raise BadInputError(f"sampling.groups.{place}.sites: {error}") from None

    def _message(self, state: str) -> tuple[Target, Mapping[str, float]]:
        """A message, with the shares of those strata that it has."""
        if not STATES[state].exists_with(self._localization):
            raise BadInputError(
                f"sampling.messages: {state}: only flights with localization {STATES[state].only_with} publish it"
            )
        if self._campaign.host == "ros1" and "length" in self._sampling.strata:
            raise BadInputError("sampling.strata: 'length': may lose a message; allowed on ROS: bits of numbers")
        own = message_target(state)
        fields = [STATES[state].find(name) for name in own.fields[state]]
        shares = self._sampling.strata
        return own, {one: shares[one] for one in shares if any(bits_of(field, one) for field in fields)} or shares

    def _first_alike(self, name: str) -> str:
        """Name of the target whose draws a target with its own lifetime shares: the first one with the same fields."""
        same = (other for other, (target, _) in self._targets.items() if target.fields == self._targets[name][0].fields)
        return next(same) if name in self._lifetimes else name

    def blocks(self, environment: str) -> Sequence[Block]:
        """One block per target; the same for parts with the same environment, which so have the same draws."""
        return self._blocks.of(self._campaign.environment_of(environment))

    def draw(self, draws: Sequence[Draw], environment: str, golden: Mapping[str, Sampled]) -> list[Fault | None]:
        """Draw from the profile of the golden run; without one, faults have no site."""
        profile = _profile(golden)
        return [self._lasting(d.target, self._draw(d, profile, environment)) for d in draws]

    def _draw(self, one: Draw, profile: Profile, environment: str) -> StateFault:
        address = (one.seed, self._campaign.environment_of(environment), one.index // self._campaign.missions)
        if self._sampling.scheme == "messages":
            return draw_in_message(one.target, one.stratum, profile, *address)
        return draw(self._targets[self._alike[one.target]][0], one.stratum, profile, *address)

    def _lasting(self, target: str, fault: StateFault) -> StateFault:
        """A fault with the lifetime of its target; a burst that exceeds its word starts at a lower bit."""
        lifetime = (self._lifetimes.get(target) or self._sampling.lifetime).model_dump()
        bits = WORD_BITS[STATES[fault.where.state].find(fault.where.field).dtype]
        width = min(lifetime["width"], bits)
        bit = None if fault.bit is None else min(fault.bit, bits - width)
        return replace(fault, **{**lifetime, "lasts_s": float(lifetime["lasts_s"]), "width": width, "bit": bit})

    def null(self, index: int, seed: int, environment: str, golden: Mapping[str, Sampled]) -> Fault:
        """A fault with an empty mask; stages alternate."""
        stage = PPC_STAGES[index % len(PPC_STAGES)]
        target = stage_target(stage, self._autopilot, localization=self._localization)
        fault = draw(target, HEADLINE, _profile(golden), seed, self._campaign.environment_of(environment), index)
        return replace(fault, bit=None, stratum="", weight=1.0)


def _profile(golden: Mapping[str, Sampled]) -> Profile:
    found = golden[""].flight.profile if "" in golden else None
    return Profile() if found is None else found
