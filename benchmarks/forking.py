"""Flies missions of a campaign the long way and forked, run by run in one process: same records, and what gain?

    python benchmarks/forking.py --missions 10
    python benchmarks/forking.py --campaign table1 --stack hardened --missions 2

Every run is flown both ways, one after the other, and both records are compared byte for byte.  Time is that of this
process (CPU), so other load on the machine shifts both.  The exit code is 1 if any record differs.
"""

import argparse
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime

from mavfi.campaign.config import load_campaign
from mavfi.campaign.plan import Arm, RunSpec, arms_of, plan_golden, plan_world
from mavfi.campaign.run import campaign_scenarios, model_hashes, versions
from mavfi.campaign.store import canonical
from mavfi.campaign.tools import host_tools
from mavfi.campaign.worker import RunResult, Task, forget_families, run_task
from mavfi.flight_log import Profile
from mavfi.hosts.forking import Family, Share

LONG, FORKED = "the long way", "forked"


@dataclass
class Account:
    """What was flown so far.

    Attributes:
        seconds: CPU time by way and setting (s).
        runs: Runs by setting.
        differing: Runs whose records differ.
        shares: Of each mission.
    """

    seconds: dict[tuple[str, str], float] = field(default_factory=lambda: defaultdict(float))
    runs: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    differing: list[str] = field(default_factory=list)
    shares: list[Share] = field(default_factory=list)

    def total(self, way: str) -> float:
        """CPU time of a way (s)."""
        return sum(seconds for (name, _), seconds in self.seconds.items() if name == way)


class Missions:
    """The missions of a campaign, as `mavfi campaign run` flies them."""

    def __init__(self, name: str, missions: int, changes: dict[str, object]) -> None:
        self.campaign = load_campaign(name).model_copy(update=changes)
        self.tools = replace(host_tools(), make_family=self._family)
        self.scenarios = campaign_scenarios(self.campaign, self.tools)
        self.arms: list[Arm] = arms_of(self.campaign, model_hashes(self.campaign, self.scenarios, None, self.tools))
        self.keys = {environment: scenario.key() for environment, scenario in self.scenarios.items()}
        self.missions = missions
        self.account = Account()

    def _family(self, scenario: object) -> Family:
        family = Family(scenario)  # type: ignore[arg-type]
        self.account.shares.append(family.share)
        return family

    def worlds(self) -> Iterator[tuple[tuple[str, int], list[RunSpec]]]:
        """Golden runs by mission; every environment in turn."""
        golden = defaultdict(list)
        for spec in plan_golden(self.campaign, self.keys, self.arms):
            golden[spec.environment, spec.seed].append(spec)
        for seed in self.campaign.seeds[: self.missions]:
            for environment in self.campaign.environments:
                yield (environment, seed), golden[environment, seed]

    def fly(self) -> None:
        """Fly all of them both ways."""
        for world, golden in self.worlds():
            profile = None
            for spec in golden:
                content = self.both(spec).profile
                profile = Profile.from_bytes(content) if content else profile
            for spec in plan_world(self.campaign, self.keys, self.arms, world, profile).values():
                self.both(spec)

    def both(self, spec: RunSpec) -> RunResult:
        """Fly one run both ways."""
        account = self.account
        results = []
        for way in (LONG, FORKED):
            scenario = self.scenarios[spec.environment].model_copy(update={"seed": spec.seed})
            task = Task(spec, scenario, self.tools, None, forking=way == FORKED)
            started = time.process_time()
            results.append(run_task(task))
            account.seconds[way, spec.setting] += time.process_time() - started
        account.runs[spec.setting] += 1
        one, other = results
        if (canonical(one.record), one.profile) != (canonical(other.record), other.profile):
            account.differing.append(spec.run_id)
        return one


def report(missions: Missions) -> str:
    """What came out, as text."""
    account = missions.account
    campaign = missions.campaign
    runs, flown = sum(account.runs.values()), account.shares
    ticks = sum(share.ticks for share in flown)
    packages = ", ".join(f"{name} {number}" for name, number in versions().items())
    lines = [
        f"{datetime.now(UTC):%Y-%m-%d}, {packages}",
        f"campaign {campaign.name}, stack {campaign.stack}, map {campaign.map}: {missions.missions} missions from seed "
        f"{campaign.first_seed} in each of {', '.join(campaign.environments)}",
        f"runs                         {runs}, of which {len(account.differing)} have another record when forked",
    ]
    for way in (LONG, FORKED):
        lines.append(f"CPU {way:<24} {account.total(way):8.1f} s, {account.total(way) / runs:.4f} s per run")
    lines += [
        f"gain                         {account.total(LONG) / account.total(FORKED):8.2f} x",
        f"share of flight simulated    {sum(share.flown for share in flown) / ticks:8.1%}",
        f"only shown to a detector     {sum(share.shown for share in flown) / ticks:8.1%}",
        f"runs that ended as another   {sum(share.joined for share in flown) / runs:8.1%}",
        f"{'setting':<22} {'runs':>5} {'long':>9} {'forked':>9} {'gain':>7}",
    ]
    for setting, count in account.runs.items():
        long, forked = (account.seconds[way, setting] / count for way in (LONG, FORKED))
        lines.append(f"{setting:<22} {count:>5} {long:>8.3f}s {forked:>8.3f}s {long / max(forked, 1e-9):>6.1f}x")
    return "\n".join([*lines, *(f"DIFFERS: {run_id}" for run_id in account.differing)])


def main() -> int:
    """Read the command line, fly, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--campaign", default="table1", help="name or path")
    parser.add_argument("--missions", type=int, default=3, help="missions per environment")
    parser.add_argument("--stack", help="instead of the campaign's")
    parser.add_argument("--map", help="instead of the campaign's")
    arguments = parser.parse_args()
    changes = {name: value for name in ("stack", "map") if (value := getattr(arguments, name)) is not None}
    missions = Missions(arguments.campaign, arguments.missions, changes)
    warm = Missions(arguments.campaign, 1, changes)
    for _, golden in list(warm.worlds())[:1]:  # compiled code is loaded before the clock runs
        for spec in golden:
            warm.both(spec)
    forget_families()
    missions.fly()
    print(report(missions))
    return 1 if missions.account.differing else 0


if __name__ == "__main__":
    sys.exit(main())
