"""`Bench`: detectors and recovery schemes flown on the same missions and faults; a YAML file in configs/bench.

A part is a campaign whose arms are the schemes.  Its faults are frozen: a list of them is shipped, and a bench reports
whether its drawn faults agree with it.
"""

import csv
import hashlib
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import Field, model_validator

from mavfi.campaign.begin import check_names
from mavfi.campaign.config import ArmConfig, Campaign, Scale, load_campaign
from mavfi.campaign.plan import FI
from mavfi.campaign.resolve import resolve
from mavfi.campaign.store import Store
from mavfi.config import Config, Name, config_root, parse, shipped
from mavfi.errors import BadInputError, SpecMismatchError, not_known
from mavfi.files import is_file

FOLDER = "bench"
SCORES_TABLE = "scores"
"""Name of the table of detection at any threshold."""
SCORED_LEVEL = "state"
"""Level of faults that can be scored: they corrupt publications."""
FAULT_COLUMNS = ("environment", "seed", "target", "index", "site", "time_s", "bit", "stratum")
"""Columns of a fault list."""
ROWS_ENDING = ".rows.csv"
"""Ending of files with published rows; those without it are fault lists."""


class BenchPart(Config):
    """One campaign of a bench."""

    campaign: str = Field(description="name or path; its arms are those of the bench")
    title: str = Field(description="of its table")
    mission: dict[str, Any] = Field({}, description="keys of a mission, in addition to those of the campaign")
    scales: dict[str, Scale] = Field({}, description="sizes, instead of the campaign's; quick is one of them")
    view: str = Field("schemes", description="table that is shown")
    nodes_die: bool = Field(False, description="of its faults: schemes without a detector are flown, too")
    scores: bool = Field(False, description="its faults in states are shown to the detectors at any threshold")


class Bench(Config):
    """Schemes under comparison, and the campaigns in which they fly."""

    name: Name
    parts: dict[Name, BenchPart] = Field(min_length=1, description="by name")
    arms: dict[str, ArmConfig] = Field(min_length=1, description="schemes by name, as the arms of a campaign")

    @model_validator(mode="after")
    def _consistent(self) -> "Bench":
        if SCORES_TABLE in self.parts:
            raise ValueError(f"parts: {SCORES_TABLE!r}: is the name of a table; allowed: any other name")
        for name in self.arms:  # a scheme that is flown alone names a folder
            if "/" in name or not name.isprintable():
                raise ValueError(f"arms: {name!r}: allowed: any name without a slash and control characters")
        for name, part in self.parts.items():
            level = level_of(load_campaign(part.campaign))
            if part.scores and level != SCORED_LEVEL:
                raise ValueError(f"parts.{name}.scores: faults of level {level!r}; allowed: {SCORED_LEVEL}")
        return self


@dataclass(frozen=True, slots=True)
class SelectedPart:
    """A part that is flown.

    Attributes:
        part: The part.
        campaign: Its campaign, with the schemes that can fly as arms.
        left_out: The other schemes, with the reason.
    """

    part: BenchPart
    campaign: Campaign
    left_out: Mapping[str, str] = field(default_factory=dict)


def load_bench(name: str) -> Bench:
    """Load a shipped bench by name, or from a YAML file.

    Raises:
        BadInputError: The bench does not exist, or is invalid.
    """
    return shipped(FOLDER, Bench, name)


def with_only(bench: Bench, detectors: Sequence[str], profile: str = "paper") -> Bench:
    """A copy of a bench with these detectors in place of its schemes, each named after its detector.

    Raises:
        BadInputError: Two detectors have the same name, or one is `none` or empty.
    """
    for name in detectors:
        if not name.strip():
            raise BadInputError(f"detector {name!r}: allowed: a name, or package:Class")
    if "none" in detectors:
        raise BadInputError("detector 'none': watches nothing; every fault is flown without a detector anyway")
    arms = {name.rpartition(":")[2]: ArmConfig(detector=name, profile=profile) for name in detectors}
    if len(arms) < len(detectors):
        raise BadInputError(f"detectors {', '.join(detectors)}: allowed: different names")
    return bench.model_copy(update={"arms": arms})


def with_schemes(bench: Bench, names: Sequence[str]) -> Bench:
    """A copy of a bench with a selection of its schemes.

    Raises:
        BadInputError: The bench has no such scheme.
    """
    for name in names:
        if name not in bench.arms:
            raise BadInputError(f"bench {bench.name}: scheme {not_known(name, bench.arms)}")
    return bench.model_copy(update={"arms": {name: bench.arms[name] for name in bench.arms if name in names}})


def scales(bench: Bench) -> list[str]:
    """Scales at which every part can be flown."""
    scales_of_parts = [{*load_campaign(part.campaign).scales, *part.scales} for part in bench.parts.values()]
    return ["quick", *sorted(set.intersection(*scales_of_parts) - {"quick"})]


def select_parts(
    bench: Bench, scale: str, *, levels: Iterable[str] = (), parts: Iterable[str] = (), models_dir: Path | None = None
) -> dict[str, SelectedPart]:
    """Select the parts to fly, by name.

    Args:
        bench: The bench.
        scale: Size of its campaigns.
        levels: Only parts with faults of these levels; empty = all.
        parts: Only these parts; empty = all.
        models_dir: Folder of trained models; None = the shipped ones.

    Raises:
        BadInputError: A part, level or size is unknown, a detector cannot be loaded, or no scheme can fly.
    """
    for name in parts:
        if name not in bench.parts:
            raise BadInputError(f"bench {bench.name}: part {not_known(name, bench.parts)}")
    campaigns = {name: _campaign_of_part(bench, name, scale) for name in parts or bench.parts}
    all_levels = {level_of(campaign) for campaign in campaigns.values()}
    for level in levels:
        if level not in all_levels:
            where = f"bench {bench.name}: "
            if parts:
                where += f"in part {', '.join(parts)}: "
            raise BadInputError(f"{where}level {not_known(level, sorted(all_levels))}")

    # A part in which no scheme can fly is left out; it is an error if that holds for all of them.
    selected = {}
    reasons: list[str] = []
    for name, campaign in campaigns.items():
        if not levels or level_of(campaign) in levels:
            part = _flyable_part(bench, name, campaign, models_dir)
            reasons += part.left_out.values()
            if part.campaign.arms:
                selected[name] = part
    if not selected:
        reasons.append("without a detector, a scheme flies only where nodes die (level instruction)")
        raise BadInputError(f"bench {bench.name}: no scheme can fly: {reasons[0]}")
    return selected


def level_of(campaign: Campaign) -> str:
    """Level of a campaign's faults; faults in states that are drawn as bits of messages are those of level message."""
    if getattr(campaign.sampling, "messages", ()):
        return "message"
    return campaign.sampling.level


def _campaign_of_part(bench: Bench, name: str, scale: str) -> Campaign:
    """The campaign of a part at a scale, with the schemes of the bench as its arms."""
    part = bench.parts[name]
    campaign = load_campaign(part.campaign)
    if scale in part.scales:
        campaign = campaign.resized(part.scales[scale])
    else:
        campaign = campaign.at_scale(scale)
    content = campaign.to_json()
    content["name"] = f"{bench.name}-{name}"
    content["mission"] = {**campaign.mission, **part.mission}
    content["scales"] = {}
    content["null_runs"] = 0
    content["arms"] = {
        arm: config.model_dump() for arm, config in bench.arms.items() if config.detector or part.nodes_die
    }
    return parse(Campaign, content, f"bench {bench.name}: {name}")


def _flyable_part(bench: Bench, name: str, campaign: Campaign, models_dir: Path | None) -> SelectedPart:
    """A part, without schemes whose detectors were trained for a different configuration."""
    check_names(campaign, f"bench {bench.name}: {name}")
    left_out = {}
    resolved = resolve(campaign, models_dir)
    for arm in resolved.arms:
        if arm.detector:
            scenario = resolved.host.resolve(resolved.spec(campaign.environments[0], arm))
            try:
                resolved.detector(arm, scenario)
            except SpecMismatchError as error:
                left_out[arm.name] = str(error)
    arms = {arm: config for arm, config in campaign.arms.items() if arm not in left_out}
    return SelectedPart(bench.parts[name], campaign.model_copy(update={"arms": arms}), left_out)


def faults_of(directory: Path) -> str:
    """The faults of a ledger as CSV text, one row per fault, in plan order."""
    rows: list[tuple[Any, ...]] = []
    with Store.open(directory) as store:
        for run in store.runs(done=True):
            spec = run.spec
            fault = spec.fault
            if spec.kind == "injected" and spec.setting == FI and fault is not None:
                bit = ""
                if fault.bit is not None:
                    bit = str(fault.bit)
                identity = (spec.environment, spec.seed, spec.target, spec.index)
                rows.append((*identity, fault.site, _time_of(fault), bit, fault.stratum))
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([FAULT_COLUMNS, *rows])
    return text.getvalue()


def _time_of(fault: Any) -> str:
    """Instant of a fault (s), or its call number and value index; empty without a site."""
    if not fault.has_site:
        return ""
    if hasattr(fault, "time_us"):
        return f"{1e-6 * fault.time_us:.6f}"
    return f"{fault.call}:{fault.index}"


def frozen_faults(bench: Bench, part: str, scale: str) -> str | None:
    """The shipped fault list of a part; None if there is none."""
    path = config_root() / FOLDER / bench.name / f"{part}-{scale}.csv"
    if is_file(path):
        return path.read_text(encoding="utf-8")
    return None


def published_rows(bench: Bench, part: str, scale: str) -> list[dict[str, str]]:
    """The shipped rows of a part's table, as text by heading; empty if there are none."""
    path = config_root() / FOLDER / bench.name / f"{part}-{scale}{ROWS_ENDING}"
    if not is_file(path):
        return []
    with path.open(encoding="utf-8", newline="") as lines:
        return list(csv.DictReader(lines))


def scheme_of(row: Mapping[str, str]) -> str:
    """Scheme of a published row, which is named by its arm, or in golden flights by its setting."""
    for heading in ("scheme", "arm"):
        if heading in row:
            return row[heading]
    return row["setting"].removeprefix("golden_")


def checksum(faults: str) -> str:
    """SHA-256 of a fault list."""
    return hashlib.sha256(faults.encode()).hexdigest()
