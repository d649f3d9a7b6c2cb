"""Several faults in one mission, as text: `state:control.command.vx:bit=62@10 + memory:planner:bit=3@alarm`.

Each is a fault of any level.  All but the first may wait for an event instead of an instant: `@injection+2`, 2 s after
the first injection; `@alarm`, at the first alarm after it, and so in what is recomputed.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from mavfi.errors import BadInputError
from mavfi.faults.combined import AND
from mavfi.faults.fault import Fault, FliesFrom, find_level
from mavfi.faults.injector import Injector
from mavfi.levels.campaign import SampledCampaign
from mavfi.levels.combined.fault import CombinedFault, is_in_calls
from mavfi.levels.combined.sampling import CombinedRequest, CombinedSampler, CombinedSampling, MemberText
from mavfi.levels.level import Level, parse, text_of
from mavfi.record import Injection

if TYPE_CHECKING:
    from mavfi.flight.host import ArmSetup, Flight
    from mavfi.flight.instruction_cases import Published


def fewer_faults(fault: CombinedFault, _: Injection | None) -> Iterator[Fault]:
    """One of the faults alone, then all but one."""
    if len(fault.faults) == 1:
        return
    for single, start in fault.members:
        if start is None:
            yield single
    if len(fault.faults) == 2:  # noqa: PLR2004 - all but one are one
        return
    for number in range(1, len(fault.faults)):
        faults = fault.faults[:number] + fault.faults[number + 1 :]
        yield CombinedFault(faults, fault.starts[:number] + fault.starts[number + 1 :])


class CombinedLevel(Level):
    """Several faults in one mission."""

    fault = CombinedFault
    sampling = CombinedSampling
    sampler = CombinedSampler
    local = True
    form = f"FAULT{AND}FAULT"
    reductions = {"faults": fewer_faults}

    def parse(self, text: str, localization: str) -> CombinedRequest:
        """See `Level.parse`; the text of several faults begins with no level."""
        texts = tuple(MemberText.of(member) for member in text.split(AND))
        requests = tuple(parse(member.text, localization) for member in texts)
        if texts[0].start is not None:
            raise BadInputError(f"@{texts[0].start}: no fault precedes it; allowed: an instant, or a fault before it")
        return CombinedRequest(texts, requests)

    def text_of(self, fault: CombinedFault) -> str | None:
        """See `Level.text_of`."""
        texts = []
        for member, start in fault.members:
            text = text_of(member)
            if text is None:
                return None
            if start is not None:
                text = f"{text.rpartition('@')[0]}@{start}"
            texts.append(text)
        return AND.join(texts)

    def seed_of(self, fault: CombinedFault) -> int | None:
        """See `Level.seed_of`: that of the first fault that needs one."""
        seeds = [find_level(member.level).seed_of(member) for member in fault.faults]
        return next((seed for seed in seeds if seed is not None), None)

    def flies_from(self, fault: CombinedFault) -> FliesFrom:
        """See `Level.flies_from`."""
        if any(is_in_calls(member) for member in fault.faults):
            return FliesFrom.CALLS
        return FliesFrom.TAKE_OFF

    def fly_forked(
        self, setup: "ArmSetup", fault: CombinedFault, detector: Any, *, records: bool = False
    ) -> "tuple[Flight, list[Published]]":
        """See `Level.fly_forked`."""
        from mavfi.levels.combined.forks import fly_serially

        return fly_serially(setup, fault.members, detector, records=records)

    def inject(self, loop: Any, fault: CombinedFault, detector: Any) -> Injector:
        """See `Level.inject`."""
        from mavfi.levels.combined.injector import CombinedInjector

        return CombinedInjector(loop, fault.members, detector)

    def columns(self, fault: CombinedFault) -> dict[str, Any]:
        """See `Level.columns`: those of the first fault."""
        first = fault.faults[0]
        columns: dict[str, Any] = find_level(first.level).columns(first)
        columns.pop("population", None)
        return columns

    def about(self, campaign: SampledCampaign) -> dict[str, Any]:
        """See `Level.about`."""
        sampling = campaign.sampling
        sources = []
        unit = "row"
        for number, member in enumerate(sampling.of):
            if isinstance(member, str):
                sources.append(member)
                continue
            alone = campaign.with_sampling(member)
            about = find_level(member.level).about(alone)
            sources.append(f"{member.level} ({about['how']})")
            if number == 0:
                unit = about["each"]
        how = f"{sampling.number} faults in each mission: {'; '.join(sources)}"
        if sampling.later:
            how += f"; those behind the first one at {sampling.later}"
        per_mission = "one fault"
        if sampling.number > 1:
            per_mission = f"{sampling.number} faults"
        return {"each": unit, "how": how, "per_mission": per_mission}
