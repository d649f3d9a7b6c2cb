"""What the instruction faults of a ledger did to missions."""

from dataclasses import dataclass

import polars as pl

from mavfi.analysis.rows import ACTIVATED, KERNEL_DUE
from mavfi.analysis.runs import Runs
from mavfi.analysis.statistics import Rate, wilson
from mavfi.campaign.plan import FI
from mavfi.errors import BadInputError
from mavfi.outcomes import Effect

_SDC = Effect.SDC.label


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
    """Missions lost in a ledger, by effect on the kernel; bits and instructions as drawn.

    Raises:
        BadInputError: No flight with a fault in an instruction is done.
    """
    own = runs.injected.where("judged", "golden_success", level="instruction", setting=FI, site_outcome=ACTIVATED)
    if not len(own):
        raise BadInputError("no flight with a fault in an instruction is done (level: instruction)")
    silent, dead = own.where(kernel_effect=_SDC), own.where(pl.col("kernel_effect").is_in(KERNEL_DUE))
    lost = [wilson(part["success"].count(False), len(part)) for part in (silent, dead)]
    return Harm(lost[0], lost[1], wilson(len(dead), len(own)))
