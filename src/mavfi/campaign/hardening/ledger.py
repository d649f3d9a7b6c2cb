"""Injections of a ledger by instruction, and the rates of silent corruption that follow for all of a kernel's sites."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from pathlib import Path

import polars as pl

from mavfi.campaign.analysis.rows import ACTIVATED, KERNEL_DUE
from mavfi.campaign.analysis.runs import Runs
from mavfi.campaign.analysis.statistics import Rate, wilson
from mavfi.campaign.plan import FI
from mavfi.errors import BadInputError
from mavfi.faults.instruction.table import Site, Table
from mavfi.hardening.rates import Groups, Rates
from mavfi.outcomes import Effect

_SDC = Effect.SDC.label


@dataclass(frozen=True, slots=True)
class Injected:
    """An activated injection of a ledger.

    Attributes:
        kernel: As in a campaign's sampling.
        function: Entry point, a field of `KernelFunctions`.
        ir_sha256: Digest of the executed code.
        block: Index of the instruction's block, as in `Site`.
        offset: Its index in the block.
        sdc: Whether the kernel's output or memory was silently corrupted.
        world: Environment and seed of the mission.
        weight: See `Fault.weight`.
    """

    kernel: str
    function: str
    ir_sha256: str
    block: int
    offset: int
    sdc: bool
    world: str
    weight: float = 1.0


def injections_of(runs: Runs, directory: Path) -> list[Injected]:
    """All activated instruction faults of flights without a detector.

    Raises:
        BadInputError: The ledger has none, or is from a version that did not store the static instruction, or sampled
            only a class of instructions.
    """
    which = runs.campaign.get("which", "all")
    if which != "all":
        raise BadInputError(f"{directory}: sampling.which: {which!r}: allowed: all, since the advice is on all of them")
    found = []
    for row in runs.injected.where("judged", level="instruction", setting=FI, site_outcome=ACTIVATED):
        details = runs.records[row["run_id"]].injections[0].details
        if "block" not in details:
            raise BadInputError(f"{directory}: flown by a version that did not store blocks; fly the campaign again")
        found.append(
            Injected(
                row["kernel"], row["function"], details["ir_sha256"], details["block"], details["offset"],
                row["kernel_effect"] == _SDC, row["world"], row["weight"],
            )
        )  # fmt: skip
    if not found:
        raise BadInputError(f"{directory}: no flight with a fault in an instruction is done (level: instruction)")
    return found


def groups_of(site: Site) -> Groups:
    """Groups of a site, from opcode and type over line and value class to the site itself."""
    opcode: Hashable = ("opcode", site.opcode, site.kind)
    return opcode, ("line", site.file, site.line, site.value_class), ("site", site.block, site.offset)


def rates_of(injections: Sequence[Injected], table: Table) -> Rates:
    """Rates of silent corruption of a function's sites, from the injections in it."""
    return Rates((groups_of(table.blocks[one.block][one.offset]), one.sdc) for one in injections)


@dataclass(frozen=True, slots=True)
class Harm:
    """What the faults of a ledger did to missions that succeed without them: what protection cannot buy.

    Attributes:
        silent: Missions lost to a silent corruption.
        dead: Missions lost to a crash, hang or exception of a kernel, whose node restarts.
        dead_share: Crashes, hangs and exceptions per injection.
    """

    silent: Rate
    dead: Rate
    dead_share: Rate


def harm_of(runs: Runs) -> Harm:
    """Missions lost in a ledger, by effect on the kernel; bits and instructions as drawn."""
    own = runs.injected.where("judged", "golden_success", level="instruction", setting=FI, site_outcome=ACTIVATED)
    silent, dead = own.where(kernel_effect=_SDC), own.where(pl.col("kernel_effect").is_in(KERNEL_DUE))
    lost = [wilson(part["success"].count(False), len(part)) for part in (silent, dead)]
    return Harm(lost[0], lost[1], wilson(len(dead), len(own)))
