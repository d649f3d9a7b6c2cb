"""Whether detectors prevent more failures than their own instructions cause, from ledgers of several campaigns.

A ledger with faults in detectors says what these cause; one with faults in kernels, flown with and without the same
detector, what it prevents.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from mavfi.campaign.analysis.failure_rate import Exposed, find_upsets, total_failures, upsets_per_instruction
from mavfi.campaign.analysis.failure_views import changes, own_parts, parts_of, verdict
from mavfi.campaign.analysis.runs import Runs
from mavfi.campaign.plan import FI
from mavfi.detectors.registry import of_monitored_fields
from mavfi.reports.text import header
from mavfi.states import PLANNERS

TITLE = "## Does a detector pay for its own instructions?"
TEXT = (
    "Failures per flight hour caused by faults in the detector's own instructions, minus failures prevented by the "
    "detector, in pairs of runs with the same fault in a kernel; below zero the detector pays. All kernels: dominated "
    "by the map with its many instructions. Planner: the kernel whose death loses missions. Prevented failures are "
    "those of the campaign with most faults in kernels under the same detector."
)
Scheme = tuple[str, str, tuple[tuple[str, Any], ...]]
"""Detector, profile if there is a choice, and keys of the mission."""
Parts = Mapping[str, tuple[int, tuple[Exposed, ...]]]


class Source(NamedTuple):
    """Changes by kernel in a campaign."""

    campaign: str
    parts: Parts

    @property
    def faults(self) -> int:
        """Number of pairs of runs."""
        return sum(count for count, _ in self.parts.values())


def scheme_of(arm: Mapping[str, Any]) -> Scheme:
    """The scheme of an arm, as `Runs.campaign` describes it, whatever its name."""
    detector, mission = str(arm["detector"]), {**arm.get("mission", {})}
    profile = str(arm["profile"]) if detector in of_monitored_fields() else ""
    return detector, profile, tuple(sorted(mission.items()))


def section(detectors: Sequence[Runs], kernels: Sequence[Runs]) -> str:
    """The section of a page.

    Args:
        detectors: Campaigns with faults in detectors.
        kernels: Campaigns with faults in kernels.
    """
    upset = upsets_per_instruction(find_upsets()).value
    rows, missing = [], dict[str, Scheme]()
    for runs in detectors:
        for environment, setting, scheme in _settings(runs):
            own = own_parts(runs, environment, setting)
            if not own:
                continue
            found = _found(kernels, environment, scheme)
            for place, source in found.items():
                parts = [*parts_of(source.parts), *(one for _, one in own)]
                word, _, rest = verdict(total_failures(parts, upset)).partition(", ")
                faults = f"{sum(count for count, _ in own)} ({_name(runs)})", f"{source.faults} ({source.campaign})"
                rows.append(
                    f"| `{setting}` | {environment} | {place} | {rest.partition(' failures')[0]} | {word} | "
                    f"{' | '.join(faults)} |"
                )
            if not found:
                missing[setting] = scheme
    head = [
        "| setting | environment | over | failures per flight hour, caused - prevented | pays | faults in it "
        "| faults in kernels |",
        "| --- | --- | --- | ---: | --- | ---: | ---: |",
    ]
    flown = [f"- faults in kernels: {' · '.join(_described(runs.campaign))}" for runs in kernels]
    return "\n".join([TITLE, "", TEXT, "", *flown, "", *head, *dict.fromkeys(rows), "", *_notes(missing)]) + "\n"


def _settings(runs: Runs) -> Iterator[tuple[str, str, Scheme]]:
    """Environments and settings of a campaign's arms with their schemes."""
    arms = {
        row["setting"]: row["arm"] for row in runs.injected if row["setting"] != FI and row["arm"] and row["detector"]
    }
    environments = runs.injected.values("environment")
    for setting, arm in arms.items():
        for environment in environments:
            yield environment, setting, scheme_of(runs.campaign["arms"][arm])


def _found(kernels: Iterable[Runs], environment: str, scheme: Scheme) -> dict[str, Source]:
    """The campaign with most faults, over all kernels and over the planner."""
    found: dict[str, Source] = {}
    for runs in kernels:
        for other, setting, own in _settings(runs):
            if (other, own) != (environment, scheme):
                continue
            every = changes(runs, environment, setting)
            places: dict[str, Collection[str]] = {"the planner": PLANNERS}
            if set(every) - set(PLANNERS):
                places = {"all kernels": every, **places}
            for place, names in places.items():
                source = Source(_name(runs), {name: part for name, part in every.items() if name in names})
                if source.parts and (place not in found or source.faults > found[place].faults):
                    found[place] = source
    return found


def _described(campaign: Mapping[str, Any]) -> Iterator[str]:
    """Campaign and digest, in the words of the other sections' headers."""
    yield campaign["title"]
    yield next(line for line in header(campaign) if "digest" in line)


def _name(runs: Runs) -> str:
    return str(runs.campaign.get("name", ""))


def _notes(missing: Mapping[str, Scheme]) -> list[str]:
    """What has to be flown for settings without a verdict."""
    known = [
        "- failures without a fault are not in the difference: pairs count whose missions succeed without one under "
        "both settings; a campaign of a bench does not count the instructions "
        "of its arms: those of flights without a detector are taken",
        "- `recommended` includes the restart policy `readback`, which needs no detector and brings back what is lost "
        "to a planner that died (table of the planner's instructions in the [leaderboard](leaderboard.md))",
    ]
    if not missing:
        return known
    names = ", ".join(f"`{setting}`" for setting in missing)
    return [
        *known,
        f"- no verdict: {names}; needed: faults in the planner under the same detectors (`mavfi bench detectors --part "
        "instruction --scale paper`, with `--scheme` for each), or in all kernels (campaign `failure_rate` with them "
        "as arms)",
    ]
