"""A ledger of trials becomes tables: outcomes with Wilson intervals, and what was struck."""

from collections import Counter
from dataclasses import asdict
from typing import Any

from mavfi.campaign.nodes.config import NodeCampaign
from mavfi.campaign.plan import FI, GOLDEN, NULL
from mavfi.campaign.statistics import CONFIDENCE, wilson
from mavfi.campaign.store import Run, Store

OUTCOMES = ("masked", "sdc", "crash", "hang")
"""What can be judged; `unknown` is counted beside."""
UNKNOWN = "unknown"
_MOST = 12


def analyse_nodes(store: Store) -> dict[str, Any]:
    """All tables of a campaign on a node, from what is done of it.

    Args:
        store: Its ledger.

    Returns:
        Plain data: `campaign`, `outcomes` (by kind of register and in all), `null_check`, `by_place` (function that was
        struck), `endings` (signals), `corruptions` (some outputs that differ), `stopped_us`.
    """
    campaign = NodeCampaign.model_validate(store.meta("identity")["campaign"])
    runs = [run for run in store.runs(done=True)]
    struck = [run for run in runs if run.spec.setting == FI]
    targets = [*campaign.registers, "in all"] if len(campaign.registers) > 1 else list(campaign.registers)
    return {
        "campaign": {
            "name": campaign.name, "node": campaign.node, "command": list(campaign.command),
            "symbol": campaign.symbol, "walk": campaign.walk, "versions": store.meta("versions"),
            "digest": store.digest(), "done": len(runs), "total": campaign.count, "confidence": CONFIDENCE,
            "golden": sum(run.spec.setting == GOLDEN for run in runs),
        },
        "outcomes": [_outcomes(struck, target) for target in targets],
        "null_check": _null_check([run for run in runs if run.spec.setting == NULL]),
        "by_place": _by_place(struck),
        "endings": dict(Counter(_record(run)["reason"] for run in struck if _outcome(run) == "crash")),
        "corruptions": [_corruption(run) for run in struck if _record(run).get("differences")],
        "stopped_us": sorted(
            _record(run)["injection"]["stopped_us"] for run in struck if _record(run).get("injection")
        ),
    }  # fmt: skip


def _record(run: Run) -> dict[str, Any]:
    assert run.record is not None
    return run.record


def _outcome(run: Run) -> str:
    return str(_record(run)["outcome"])


def _outcomes(struck: list[Run], target: str) -> dict[str, Any]:
    own = [_outcome(run) for run in struck if target in ("in all", run.spec.target)]
    judged = [outcome for outcome in own if outcome != UNKNOWN]
    rates = {outcome: asdict(wilson(judged.count(outcome), len(judged))) for outcome in OUTCOMES}
    return {"registers": target, "n": len(judged), UNKNOWN: len(own) - len(judged), **rates}


def _null_check(nulls: list[Run]) -> dict[str, Any]:
    differing = [run.spec.run_id for run in nulls if _outcome(run) != "masked"]
    return {"n": len(nulls), "differing": differing, "passed": not differing}


def _by_place(struck: list[Run]) -> list[dict[str, Any]]:
    """Outcomes by the function whose instruction was struck, most often struck first."""
    found: dict[str, Counter[str]] = {}
    for run in struck:
        injection = _record(run).get("injection")
        if injection:
            place = injection["symbol"].rpartition("+")[0] or injection["library"].rpartition("/")[2]
            found.setdefault(place, Counter())[_outcome(run)] += 1
    rows = sorted(found.items(), key=lambda item: (-item[1].total(), item[0]))
    return [{"place": place, "n": counts.total(), **counts} for place, counts in rows[:_MOST]]


def _corruption(run: Run) -> dict[str, Any]:
    record, injection = _record(run), _record(run)["injection"]
    return {
        "run_id": run.spec.run_id, "register": injection["register"], "bit": injection["bit"],
        "instruction": injection["instruction"], "differing": record["differing"], "asked": record["asked"],
        **record["differences"][0],
    }  # fmt: skip
