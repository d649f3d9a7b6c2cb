"""Compares missions of a campaign with and without fast-forward in one process: equality of records, and speed-up.

    python -m benchmarks.fast_forward --missions 10
    python -m benchmarks.fast_forward --campaign table1 --autopilot hardened --missions 2
    python -m benchmarks.fast_forward --campaign table1_instructions --faults 1 --missions 4
    python -m benchmarks.fast_forward --part sites --scheme checksum --scheme recommended --missions 1

Every mission is flown in both modes, one after the other, and every record is compared.  Time is CPU time of this
process and its children, so that other load on the machine affects both.  The exit code is 1 if any record differs.
"""

import argparse
import os
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime

from mavfi.campaign.config import Campaign, load_campaign
from mavfi.campaign.fingerprint import versions
from mavfi.campaign.mission import MissionPlan, fly_mission
from mavfi.campaign.plan import CompletedRun, Planned
from mavfi.campaign.resolve import resolve
from mavfi.extras.bench.bench import load_bench, select_parts, with_schemes
from mavfi.record import FlightRecord

TAKE_OFF, FAST = "from take-off", "fast-forward"


@dataclass
class Account:
    """Results so far.

    Attributes:
        seconds: CPU time by mode and setting (s).
        runs: Number of runs by setting.
        differing: Ids of runs whose records differ.
    """

    seconds: dict[tuple[str, str], float] = field(default_factory=lambda: defaultdict(float))
    runs: Counter[str] = field(default_factory=Counter)
    differing: list[str] = field(default_factory=list)

    def total(self, way: str) -> float:
        """CPU time of a mode (s)."""
        return sum(seconds for (name, _), seconds in self.seconds.items() if name == way)


def plans(campaign: Campaign, missions: int) -> Iterator[dict[str, MissionPlan]]:
    """Missions in alternating environments, each in both modes."""
    resolved = resolve(campaign).with_models()
    for seed in campaign.seeds[:missions]:
        for environment in campaign.environments:
            yield {way: MissionPlan(resolved, environment, seed, fast_forward=way == FAST) for way in (TAKE_OFF, FAST)}


def cpu_s() -> float:
    """CPU time of this process and of its children that have ended (s)."""
    return sum(os.times()[:4])


def fly(plan: MissionPlan, way: str, account: Account) -> dict[str, FlightRecord]:
    """Records of a mission by run; adds its CPU time to the account."""
    settings: dict[str, str] = {}
    records: dict[str, FlightRecord] = {}
    since = cpu_s()
    for item in fly_mission(plan):
        if isinstance(item, Planned):
            settings |= {spec.run_id: spec.setting for spec in item.specs}
        elif isinstance(item, CompletedRun):
            records[item.run_id] = item.record
            now = cpu_s()
            account.seconds[way, settings[item.run_id]] += now - since
            since = now
    if way == TAKE_OFF:
        account.runs.update(settings.values())
    return records


def compare(campaign: Campaign, missions: int) -> Account:
    """Fly all missions in both modes."""
    account = Account()
    for both in plans(campaign, missions):
        one, other = (fly(plan, way, account) for way, plan in both.items())
        account.differing += [run_id for run_id in one | other if one.get(run_id) != other.get(run_id)]
    return account


def report(campaign: Campaign, missions: int, account: Account) -> str:
    """The result as text."""
    runs = sum(account.runs.values())
    lines = [
        f"{datetime.now(UTC):%Y-%m-%d}, {', '.join(f'{name} {number}' for name, number in versions().items())}",
        f"campaign {campaign.name}, {campaign.mission}: {missions} missions from seed {campaign.first_seed} in each of "
        f"{', '.join(campaign.environments)}",
        f"{'runs':<22} {runs:>5}, of which {len(account.differing)} have another record with fast-forward",
    ]
    lines += [
        f"CPU {way:<18} {account.total(way):8.1f} s, {account.total(way) / runs:.4f} s per run"
        for way in (TAKE_OFF, FAST)
    ]
    lines += [
        f"gain {account.total(TAKE_OFF) / account.total(FAST):.2f} x",
        f"{'setting':<22} {'runs':>5} {'take-off':>9} {'fast':>9} {'gain':>7}",
    ]
    for setting, count in account.runs.items():
        slow, fast = (account.seconds[way, setting] / count for way in (TAKE_OFF, FAST))
        lines.append(f"{setting:<22} {count:>5} {slow:>8.3f}s {fast:>8.3f}s {slow / max(fast, 1e-9):>6.1f}x")
    return "\n".join([*lines, *(f"DIFFERS: {run_id}" for run_id in account.differing)])


def main() -> int:
    """Parse the command line, fly, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--campaign", default="table1", help="name or path")
    parser.add_argument("--part", help="of the shipped bench, at scale paper, in place of a campaign")
    parser.add_argument("--scheme", action="append", default=[], help="of the bench; may be repeated, all by default")
    parser.add_argument("--missions", type=int, default=3, help="missions per environment")
    parser.add_argument("--faults", type=int, help="per mission and group, instead of the campaign's")
    parser.add_argument("--autopilot", help="instead of the campaign's")
    parser.add_argument("--map", help="instead of the campaign's")
    arguments = parser.parse_args()
    changes = {name: value for name in ("autopilot", "map") if (value := getattr(arguments, name)) is not None}
    if arguments.part is None:
        campaign = load_campaign(arguments.campaign)
    else:
        bench = load_bench("mavfi-bench-1")
        bench = with_schemes(bench, arguments.scheme or list(bench.arms))
        campaign = select_parts(bench, "paper", parts=[arguments.part])[arguments.part].campaign
    campaign = campaign.model_copy(update={"mission": {**campaign.mission, **changes}})
    if arguments.faults is not None:
        campaign = campaign.model_copy(update={"faults": arguments.faults * campaign.missions})
    for plan in next(plans(campaign, 1)).values():  # load compiled code before timing
        fly(plan, "warm", Account())
    account = compare(campaign, arguments.missions)
    print(report(campaign, arguments.missions, account))
    return 1 if account.differing else 0


if __name__ == "__main__":
    sys.exit(main())
