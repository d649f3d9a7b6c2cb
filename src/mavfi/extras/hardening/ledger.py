"""A campaign of instruction faults as input of the choice: missions, rates, what faults cost, and the proof.

Its faults say how often an instruction that is changed leads to a silent corruption.  There are fewer faults than
instructions, so rates are those of groups: opcode and type, then source line and value class.
"""

from collections import Counter
from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import polars as pl

from mavfi.analysis.requirements import judge
from mavfi.analysis.rows import ACTIVATED, KERNEL_DUE
from mavfi.analysis.runs import Runs
from mavfi.campaign.config import Campaign
from mavfi.campaign.ledger import stored_campaign
from mavfi.campaign.plan import FI
from mavfi.campaign.requirement import Requirement
from mavfi.campaign.resolve import ResolvedCampaign, resolve
from mavfi.campaign.store import Store
from mavfi.errors import BadInputError, not_known
from mavfi.extras.hardening.vulnerability.lines import SDC, no_instruction_faults
from mavfi.flight.targets import Targets
from mavfi.ir.injection.table import InjectionSite
from mavfi.levels.instruction.sampling import campaign_targets
from mavfi.mission import Scenario
from mavfi.states import PLANNERS

MAX_OBSERVED = 2
"""Missions of a ledger in which executions are counted and calls are recorded, at most."""
STRENGTH = 4.0
"""Number of imaginary faults with which the rate of a group is shrunk to that of the next larger group."""
PROTECTED = "protected"
"""Name of the arm of a proof."""
Groups = tuple[Hashable, ...]
"""Groups of an instruction, the larger one first: opcode and type, then source line and value class."""


def groups_of(opcode: str, kind: str, file: str, line: int, value_class: str) -> Groups:
    """Groups of an instruction."""
    return (opcode, kind), (file, line, value_class)


class CorruptionRates:
    """Rates of silent corruption per fault.

    The rate of a group with k corruptions of n faults is (k + 4 p) / (n + 4), where p is the rate of the next larger
    group.

    Args:
        faults: Groups of each injected instruction, and whether the fault was a silent corruption.
    """

    def __init__(self, faults: Iterable[tuple[Groups, bool]]) -> None:
        self._faults: Counter[Hashable] = Counter()
        self._corruptions: Counter[Hashable] = Counter()
        for groups, silent in faults:
            for group in (None, *groups):  # None: all instructions
                self._faults[group] += 1
                self._corruptions[group] += silent

    def of(self, site: InjectionSite) -> float:
        """Rate of an instruction, whether injected or not; 0 without any fault."""
        rate = self._corruptions[None] / max(self._faults[None], 1)
        for group in groups_of(site.opcode, site.kind, site.file, site.line, site.value_class):
            rate = (self._corruptions[group] + STRENGTH * rate) / (self._faults[group] + STRENGTH)
        return rate


class Losses(NamedTuple):
    """What the faults of a ledger did to missions that succeed without them: the most that protection could save.

    Attributes:
        silent: Number of silent corruptions.
        lost_silent: Missions that silent corruptions lost.
        dead: Number of crashes, hangs and exceptions of a kernel, whose node restarts.
        lost_dead: Missions that dead kernels lost.
    """

    silent: int
    lost_silent: int
    dead: int
    lost_dead: int


@dataclass(frozen=True)
class HardeningLedger:
    """A campaign of instruction faults.

    Attributes:
        directory: Folder of its ledger.
        campaign: The campaign.
        digest: Digest of its runs.
        kernels: Kernels to protect.
    """

    directory: Path
    campaign: Campaign
    digest: str
    kernels: tuple[str, ...]

    @staticmethod
    def open(directory: Path, kernels: Sequence[str] = ()) -> "HardeningLedger":
        """Open a ledger; no `kernels` = all in which it has faults.

        Raises:
            BadInputError: It is not a ledger of instruction faults, or has none in a kernel.
        """
        with Store.open(directory) as store:
            campaign = stored_campaign(store)
            digest = store.digest()
        sampled: tuple[str, ...] = ()
        if campaign.sampling.level == "instruction":
            # A campaign may sample instructions of detectors, too: these belong to an arm, and are not protected.
            sampled = tuple(target.name for target in campaign_targets(campaign) if not target.arm)
        if not sampled:
            raise no_instruction_faults(directory)
        for kernel in kernels:
            if kernel not in sampled:
                raise BadInputError(f"--kernels: {not_known(kernel, sampled)}")
        return HardeningLedger(directory, campaign, digest, tuple(kernels) or sampled)

    # ---- missions ---------------------------------------------------------------------------------------------------
    def by_planner(self) -> dict[str, tuple[str, ...]]:
        """All kernels of the missions that are flown, by planner; that of the campaign's mission comes first."""
        environment = self.campaign.environments[0]
        seed = self.campaign.first_seed
        planner_of_campaign = self.campaign.spec(environment, seed).planner
        planners = dict.fromkeys([planner_of_campaign, *(kernel for kernel in self.kernels if kernel in PLANNERS)])
        return {planner: tuple(Targets(self._scenario(environment, seed, planner)).names) for planner in planners}

    def observed(self, planner: str) -> list[Scenario]:
        """Missions of the ledger that the choice observes, evenly over the environments."""
        missions = [(environment, seed) for seed in self.campaign.seeds for environment in self.campaign.environments]
        return [self._scenario(environment, seed, planner) for environment, seed in missions[:MAX_OBSERVED]]

    def _scenario(self, environment: str, seed: int, planner: str) -> Scenario:
        scenario: Scenario = self._resolved.host.resolve(self.campaign.spec(environment, seed, {"planner": planner}))
        return scenario

    @cached_property
    def _resolved(self) -> ResolvedCampaign:
        return resolve(self.campaign)

    # ---- faults -----------------------------------------------------------------------------------------------------
    @cached_property
    def _runs(self) -> Runs:
        """All runs of the ledger."""
        return Runs.read(self.directory)

    @cached_property
    def faults(self) -> Runs:
        """Flights without a detector whose fault met its instruction in one of the kernels.

        Raises:
            BadInputError: There is none.
        """
        runs = self._runs.injected.where("judged", level="instruction", setting=FI, site_outcome=ACTIVATED)
        faults = runs.where(pl.col("kernel").is_in(self.kernels))
        if not len(faults):
            raise BadInputError(
                "no flight with a fault in an instruction has ended and met its instruction; "
                "`mavfi campaign run` flies the rest"
            )
        return faults

    def rates(self, kernels: Sequence[str]) -> CorruptionRates:
        """Rates of silent corruption of a kernel's output, by the faults in some kernels."""
        faults = self.faults.where(pl.col("kernel").is_in(kernels))
        columns = (faults[name] for name in ("opcode", "value_type", "file", "line", "value_class"))
        instructions = zip(*columns, strict=True)
        return CorruptionRates(
            (groups_of(*instruction), effect == SDC)
            for instruction, effect in zip(instructions, faults["kernel_effect"], strict=True)
        )

    @property
    def losses(self) -> Losses:
        """Missions that silent corruptions and dead kernels lost."""
        informative = self.faults.where("golden_success")
        silent = informative.where(kernel_effect=SDC)
        dead = informative.where(pl.col("kernel_effect").is_in(KERNEL_DUE))
        is_lost = ~pl.col("success")
        return Losses(len(silent), len(silent.where(is_lost)), len(dead), len(dead.where(is_lost)))

    # ---- proof ------------------------------------------------------------------------------------------------------
    def proof(self, plan: Path) -> dict[str, Any]:
        """The campaign that proves a plan: the same faults in plain and in protected code, on the seeds that follow.

        It requires fewer silent corruptions in protected code than the ledger has in plain code.

        Args:
            plan: The file of the plan.

        Raises:
            BadInputError: The ledger has no silent corruption.
        """
        # The share of silent corruptions that protected code has to stay below.
        (verdict,) = judge(self._runs.where(pl.col("kernel").is_in(self.kernels)), [Requirement.parse("sdc < 100 %")])
        if not verdict.rate.rate:
            raise BadInputError(f"{self.directory}: no fault is a silent corruption; there is nothing to protect from")

        # The same campaign in protected code, on the seeds that follow.
        content = self.campaign.to_json()
        unchanged = {
            key: content[key] for key in ("environments", "missions", "faults", "mission", "parts") if content.get(key)
        }
        return {
            "name": f"{self.campaign.name}_proof",
            **unchanged,
            "first_seed": self.campaign.seeds.stop,
            "sampling": {**content["sampling"], "kernels": list(self.kernels)},
            "arms": {PROTECTED: {"protection": str(plan)}},
            "require": [f"{PROTECTED}: sdc < {100 * verdict.rate.rate:.1f} %"],
        }
