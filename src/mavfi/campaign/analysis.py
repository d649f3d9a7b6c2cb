"""A ledger becomes tables: plain data that reports show and that can be made again whenever a definition changes."""

from pathlib import Path
from typing import Any

from mavfi.campaign import detection, effects, kernel_analysis, kernel_success, paper, success
from mavfi.campaign.config import Campaign
from mavfi.campaign.flights import read_rows
from mavfi.campaign.plan import count_runs
from mavfi.campaign.run import stored_campaign
from mavfi.campaign.statistics import CONFIDENCE
from mavfi.campaign.store import Store

REMARKS = (
    f"{paper.NOTE}.",
    "Rates are conditional on one fault per mission.",
    "A one-shot fault in a state heals on any recomputation: recovery equals detection by construction.",
    "Recomputation is charged in the platform's modelled time; nothing was measured on that hardware.",
    "Faults without a site and faults that were not hit are kept in every rate (intention to treat).",
)


def analyse(directory: Path) -> dict[str, Any]:
    """All tables of a campaign, from what is flown of it.

    Args:
        directory: Where its ledger is.

    Returns:
        Plain data: `campaign` (what was flown), `remarks`, and lists of entries: `success`, `by_stage`, `by_target`,
        `by_state`, `by_field`, `by_bits`, `recovery`, `golden_against_faults`, `separable`, `outcomes`, `endings`,
        `golden`, `flight_times`, `unmonitored_failures`, `acted_on`, `false_alarms`, `detections`, `overheads`,
        `success_by_policy` (see `kernel_success`; of faults in instructions only); and `null_check`, and `kernels`
        (see `kernel_analysis`, with `stages`: struck kernels by stage; None where no instructions were struck).

    Raises:
        BadInputError: There is no ledger.
    """
    with Store.open(directory) as store:
        campaign = stored_campaign(store)
        rows = read_rows(store)
        watched = campaign.monitored_set
        return {
            "campaign": describe(campaign, store, len(rows)),
            "remarks": list(REMARKS if campaign.kernels is None else kernel_analysis.REMARKS),
            "success": success.success_by_environment(rows),
            "by_stage": success.success_by(rows, "stage", lambda row: row.stage),
            "by_target": success.success_by(rows, "target", lambda row: row.spec.target),
            "by_state": success.success_by(rows, "state", lambda row: row.state),
            "by_field": success.success_by(rows, "field", lambda row: row.field),
            "by_bits": success.success_by(rows, "bits", lambda row: row.bits),
            "recovery": success.recoveries(rows),
            "golden_against_faults": success.golden_against_faults(rows),
            "separable": success.separable(rows),
            "outcomes": effects.outcomes(rows),
            "endings": effects.endings(rows),
            "golden": effects.golden_flights(rows),
            "flight_times": effects.flight_times(rows),
            "unmonitored_failures": effects.unmonitored_failures(rows, watched),
            "acted_on": effects.acted_on(rows, store),
            "null_check": effects.null_check(rows),
            "false_alarms": detection.false_alarms(rows),
            "detections": detection.detections(rows, watched),
            "overheads": detection.overheads(rows),
            "success_by_policy": kernel_success.success_by_policy(rows) if campaign.kernels is not None else [],
            "kernels": _kernels(campaign, store),
        }


def _kernels(campaign: Campaign, store: Store) -> dict[str, Any] | None:
    if campaign.kernels is None:
        return None
    return {**kernel_analysis.analyse_kernels(store), "stages": kernel_success.stages_of(campaign)}


def describe(campaign: Campaign, store: Store, done: int) -> dict[str, Any]:
    """What was flown, for the header of every table."""
    kernels = campaign.kernels
    return {
        "name": campaign.name,
        "stack": campaign.stack,
        "platform": campaign.platform,
        "planner": campaign.planner,
        "v_max": campaign.v_max,
        "environments": list(campaign.environments),
        "seeds": [campaign.seeds.start, campaign.seeds.stop - 1],
        "on_design_seeds": campaign.on_design_seeds,
        "flights": campaign.flights,
        "faults": campaign.faults,
        "law": campaign.law,
        "sites": campaign.sites,
        "strata": dict(campaign.strata) if kernels is None else {},
        **({} if kernels is None else {"kernels": kernels.model_dump(mode="json")}),
        "monitored_set": campaign.monitored_set,
        "detectors": {name: arm.model_dump() for name, arm in campaign.detectors.items()},
        "models": store.meta("identity")["models"],
        "confidence": CONFIDENCE,
        "versions": store.meta("versions"),
        "digest": store.digest(),
        "done": done,
        "total": count_runs(campaign),
    }
