"""What a campaign is: the YAML files of configs/campaigns."""

import hashlib
import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, model_validator

from mavfi.campaign.nodes.config import KIND, NodeCampaign
from mavfi.campaign.scales import at_scale
from mavfi.config import Config, config_root, load, read_yaml
from mavfi.errors import BadInputError
from mavfi.faults.sampling import group_target, stage_target
from mavfi.faults.strata import STRATA
from mavfi.states import KERNEL_STAGES, MONITORED_SETS, PPC_STAGES

DESIGN_SEEDS = range(10_000)
"""Seeds that the stacks were tuned on."""
KERNELS = tuple(KERNEL_STAGES)
"""Kernels that can be struck at instruction level."""
PLANNER_KERNELS = ("rrt", "rrt_connect", "rrt_star")
"""Those of which a mission flies one."""
TRAINING_SEED = 1_000_000
"""First seed of the flights that detectors are trained on; no campaign flies these."""


class DetectorArm(Config):
    """A detector with which every golden and every faulty flight is flown again."""

    detector: str = Field(description="entry point of the group mavfi.detectors, or package:Class")
    profile: Literal["paper", "tuned"] = "paper"


class SiteGroup(Config):
    """Fields that are struck as one row of a table; one of them per fault, uniform."""

    name: str
    sites: tuple[str, ...] = Field(min_length=1, description="state.field")
    strata: dict[str, float] | None = Field(None, description="instead of the campaign's")


class KernelFaults(Config):
    """Faults in the instructions of kernels (law `kernels`)."""

    names: tuple[str, ...] = Field(min_length=1, description="as in mavfi.pipeline.functions.STRUCK")
    share: Literal["kernel", "stage"] = Field(
        "kernel", description="what `faults` counts: each kernel, or each stage, whose kernels share them equally"
    )
    which: str = Field("all", description="class of instructions, e.g. floating_point")
    model: Literal["one_bit", "bits", "random", "zero"] = "one_bit"
    restart_s: float = Field(0.57, ge=0, le=60, description="until a node that died answers again (s)")
    sampling: Literal["uniform", "stratified"] = Field(
        "uniform", description="over dynamic instructions, or by value class and source line with weights"
    )


class Scale(Config):
    """How many flights."""

    flights: int = Field(ge=1)
    faults: int = Field(ge=1)


class Campaign(Config):
    """A campaign as a user writes it.

    `flights` missions per environment, from `first_seed` on.  `faults` faults per environment for each stage (law
    `stage_balanced`), each group (law `groups`) or each kernel or stage (law `kernels`, as its key `share` says); fault
    i strikes in mission i modulo `flights`.  `strata` are the shares of these faults by bit stratum; in kernels bits
    are drawn uniformly.
    """

    name: str
    environments: tuple[str, ...] = Field(min_length=1)
    first_seed: int = Field(10_000, ge=0)
    flights: int = Field(30, ge=1)
    faults: int = Field(30, ge=1)
    scales: dict[str, Scale] = Field(default_factory=dict, description="other sizes, by name")
    law: Literal["stage_balanced", "groups", "kernels"] = "stage_balanced"
    sites: Literal["all", "monitored"] = Field("all", description="fields that stage_balanced draws from")
    monitored_set: str = "paper-13"
    groups: tuple[SiteGroup, ...] = ()
    kernels: KernelFaults | None = None
    strata: dict[str, float] = Field(default_factory=lambda: {"sign_exponent": 2.0, "mantissa": 1.0})
    null_runs: int = Field(3, ge=0, description="per environment; with each detector in turn")
    stack: str = "published"
    platform: str = "i9-9940x"
    planner: str = "rrt_connect"
    map: str = "dense"
    vehicle: str | None = Field(None, description="name or path; None = the environment's")
    v_max: float | None = Field(None, gt=0, description="m/s; None = the environment's")
    detectors: dict[str, DetectorArm] = Field(default_factory=dict, description="by the name of the arm")

    @model_validator(mode="after")
    def _consistent(self) -> "Campaign":
        flights = max([self.flights, *(scale.flights for scale in self.scales.values())])
        if self.first_seed + flights > TRAINING_SEED:
            raise ValueError(
                f"first_seed: {self.first_seed}, flights: {flights}: seeds from {TRAINING_SEED} on are for training"
            )
        if (self.law == "groups") != bool(self.groups):
            raise ValueError(f"law: {self.law!r}: groups are given where, and only where, law is 'groups'")
        _check_kernels(self)
        if self.monitored_set not in MONITORED_SETS:
            raise ValueError(f"monitored_set: {self.monitored_set!r}: not known; allowed: {', '.join(MONITORED_SETS)}")
        _check_distinct("environments", self.environments)
        _check_distinct("groups", [group.name for group in self.groups])
        for strata in (self.strata, *(group.strata for group in self.groups if group.strata is not None)):
            _check_strata(strata)
        _check_targets(self)
        return self

    def at_scale(self, name: str) -> "Campaign":
        """The campaign at another size; see `mavfi.campaign.scales`."""
        return at_scale(self, self.name, self.scales, name)

    @property
    def seeds(self) -> range:
        """Seeds of the missions in each environment."""
        return range(self.first_seed, self.first_seed + self.flights)

    @property
    def on_design_seeds(self) -> bool:
        """Whether a mission has one of the seeds that the stacks were tuned on: no figure for publication."""
        return self.first_seed < DESIGN_SEEDS.stop

    def key(self) -> str:
        """Hash that identifies the campaign."""
        return hashlib.sha256(json.dumps(self.to_json(), sort_keys=True).encode()).hexdigest()

    def to_json(self) -> dict[str, Any]:
        """Plain data; `kernels` is in it only where they are struck, and how they are sampled where not uniformly."""
        data = self.model_dump(mode="json")
        if self.kernels is None:
            del data["kernels"]
        elif self.kernels.sampling == "uniform":
            del data["kernels"]["sampling"]
        return data


def _check_kernels(campaign: Campaign) -> None:
    """What the law `kernels` needs, and what it excludes."""
    if (campaign.law == "kernels") != (campaign.kernels is not None):
        raise ValueError(f"law: {campaign.law!r}: kernels are given where, and only where, law is 'kernels'")
    if campaign.kernels is None:
        return
    unknown = sorted(set(campaign.kernels.names) - set(KERNELS))
    if unknown:
        raise ValueError(f"kernels: {unknown[0]!r}: not known; allowed: {', '.join(KERNELS)}")
    _check_distinct("kernels", campaign.kernels.names)
    others = [name for name in campaign.kernels.names if name in PLANNER_KERNELS and name != campaign.planner]
    if campaign.detectors and others:
        raise ValueError(
            f"kernels: {others[0]!r}: detectors are trained with one planner; allowed with detectors: kernels of "
            f"missions with planner {campaign.planner!r}"
        )
    if campaign.null_runs:
        raise ValueError(f"null_runs: {campaign.null_runs}; allowed: 0 where law is 'kernels' (nothing is drawn there)")


def _check_distinct(key: str, names: Sequence[str]) -> None:
    for name, count in Counter(names).items():
        if count > 1:
            raise ValueError(f"{key}: {name!r}: named {count} times; allowed: once")


def _check_strata(strata: dict[str, float]) -> None:
    unknown = set(strata) - set(STRATA)
    if unknown:
        raise ValueError(f"strata: {sorted(unknown)[0]!r}: not known; allowed: {', '.join(STRATA)}")
    if not strata or not all(0 < share < float("inf") for share in strata.values()):
        raise ValueError(f"strata: {strata}: need at least one name, and shares above 0")


def _check_targets(campaign: Campaign) -> None:
    """Every stratum must have bits in every target: checked when the file is read, not when the faults are drawn."""
    monitored = campaign.monitored_set if campaign.sites == "monitored" else None
    try:
        for group in campaign.groups:
            for stratum in group.strata or campaign.strata:
                group_target(group.name, group.sites).within(stratum)
        for stage in PPC_STAGES if campaign.law == "stage_balanced" else ():
            for stratum in campaign.strata:
                stage_target(stage, campaign.stack, monitored).within(stratum)
    except BadInputError as error:
        raise ValueError(str(error)) from None


def load_campaign(name: str | Path) -> Campaign:
    """Read a campaign of flights: a path, or the name of a shipped one, e.g. "table1".

    Raises:
        BadInputError: There is no such file, or something in it is wrong.
    """
    return load(Campaign, campaign_path(name))


def load_any(name: str | Path) -> Campaign | NodeCampaign:
    """The same, or a campaign on a ROS node: which one it is says the key `kind`.

    Raises:
        BadInputError: There is no such file, or something in it is wrong.
    """
    path = campaign_path(name)
    kind = read_yaml(path).get("kind")
    if kind is None:
        return load(Campaign, path)
    if kind != KIND:
        raise BadInputError(f"{path}: key 'kind': {kind!r}: not known; allowed: {KIND}, or no such key: flights")
    return load(NodeCampaign, path)


def campaign_path(name: str | Path) -> Path:
    """File of a campaign.

    Args:
        name: A path, or the name of a shipped campaign.

    Raises:
        BadInputError: There is none of that name.
    """
    path = Path(name)
    if path.suffix in (".yaml", ".yml"):
        return path
    shipped = config_root() / "campaigns"
    path = shipped / f"{name}.yaml"
    if not path.is_file():
        allowed = ", ".join(sorted(file.stem for file in shipped.glob("*.yaml")))
        raise BadInputError(f"campaign {str(name)!r}: not known; allowed: {allowed}, or a path to a .yaml file")
    return path
