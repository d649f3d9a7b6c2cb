"""Runs a campaign on a ROS node: golden trials, then the strikes; goes on where it stopped."""

import time
import traceback
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from mavfi.campaign.executors.local import LocalPool, Lost
from mavfi.campaign.nodes.config import NodeCampaign
from mavfi.campaign.plan import FI, GOLDEN, NULL, PHASE_GOLDEN, PHASE_INJECTED, RunSpec
from mavfi.campaign.run import Progress, Status, check_versions, status
from mavfi.campaign.store import Store
from mavfi.campaign.worker import End, RunResult, plain
from mavfi.errors import BadInputError, MavfiError

_STRIKE_PATIENCE_S = 20.0


@dataclass(frozen=True, slots=True)
class NodeTask:
    """A trial, and all that is needed to run it.

    Attributes:
        spec: The trial; `target` is the kind of registers.
        campaign: Its campaign.
        golden: Hash of the golden output to each input; empty for golden trials.
    """

    spec: RunSpec
    campaign: NodeCampaign
    golden: tuple[str, ...]


def plan_golden(campaign: NodeCampaign) -> list[RunSpec]:
    """Trials without a strike."""
    return [_spec(campaign, PHASE_GOLDEN, GOLDEN, "", index) for index in range(campaign.golden_runs)]


def plan_strikes(campaign: NodeCampaign) -> list[RunSpec]:
    """Trials with a strike, kinds of registers in turn, and null trials."""
    strikes = [
        _spec(campaign, PHASE_INJECTED, FI, registers, index)
        for index in range(campaign.trials)
        for registers in campaign.registers
    ]
    kinds = campaign.registers
    nulls = [
        _spec(campaign, PHASE_INJECTED, NULL, kinds[index % len(kinds)], index) for index in range(campaign.null_runs)
    ]
    return strikes + nulls


def _spec(campaign: NodeCampaign, phase: int, setting: str, target: str, index: int) -> RunSpec:
    node = campaign.node.strip("/")
    return RunSpec(phase, setting, node, campaign.first_seed + index, campaign.key()[:16], target, index)


def run_node_task(task: NodeTask) -> RunResult:
    """Run a trial and record it; a failure of ours is recorded as `unknown`, never as an effect of the strike.

    Args:
        task: The trial.

    Raises:
        BadInputError: Whatever makes every trial impossible.
    """
    from mavfi.hosts.node.trial import UNKNOWN, run_trial

    started = time.perf_counter()
    try:
        result = run_trial(_order(task))
    except BadInputError:
        raise
    except Exception as error:  # whatever it is, the campaign goes on, counts it and shows it
        record = {"end": End.UNKNOWN, "outcome": UNKNOWN, "reason": str(error), "success": False}
        return RunResult(plain(record), None, traceback.format_exc(), time.perf_counter() - started)
    end = End.UNKNOWN if result.outcome == UNKNOWN else End.FLOWN
    record = plain({"end": end, "success": result.outcome == "masked", **asdict(result)})
    return RunResult(record, None, "", time.perf_counter() - started)


def _order(task: NodeTask) -> Any:
    from mavfi.hosts.node.trial import Order

    campaign, spec = task.campaign, task.spec
    strike = None
    if spec.setting != GOLDEN:
        strike = {
            "seed": spec.seed, "registers": spec.target, "access": campaign.access, "symbol": campaign.symbol,
            "walk": campaign.walk, "timeout": _STRIKE_PATIENCE_S, "null": spec.setting == NULL,
        }  # fmt: skip
    return Order(
        campaign.node, campaign.command, campaign.parameters, campaign.inputs.topic, campaign.inputs.type,
        campaign.inputs.messages, campaign.outputs.topic, campaign.outputs.ignore, campaign.patience_s,
        campaign.cycles, task.golden, strike,
    )  # fmt: skip


def run_node_campaign(
    campaign: NodeCampaign, directory: Path, *, workers: int = 1, progress: Callable[[Progress], None] | None = None
) -> Status:
    """Run a campaign on a node, or what is left of it.

    Args:
        campaign: What to run.
        directory: Where its ledger is, or will be.
        workers: Number of trials at once.
        progress: Called after every trial, in this process.

    Returns:
        The end state.

    Raises:
        BadInputError: As `run_campaign`; ROS is not installed, or something in the campaign is not known to it.
        MavfiError: The node cannot be tried: it does not come up, or gives no output.
    """
    from mavfi.hosts.node.private import private_network
    from mavfi.hosts.ros1.finder import require

    pool = LocalPool(workers)
    require()
    private_network()
    with Store.create(directory, {"campaign": campaign.model_dump(mode="json")}) as store:
        check_versions(store)
        sitting = _Sitting(campaign, store, pool, progress)
        store.plan(PHASE_GOLDEN, plan_golden(campaign))
        sitting.run(PHASE_GOLDEN, ())
        golden = _golden(store, campaign)
        store.plan(PHASE_INJECTED, plan_strikes(campaign))
        sitting.run(PHASE_INJECTED, golden)
    return status(directory)


class _Sitting:
    """A campaign between start and stop of the process."""

    def __init__(
        self, campaign: NodeCampaign, store: Store, pool: LocalPool, report: Callable[[Progress], None] | None
    ) -> None:
        self._campaign, self._store, self._pool, self._report = campaign, store, pool, report
        self._started, self._done = time.perf_counter(), 0
        self._tell()

    def run(self, phase: int, golden: tuple[str, ...]) -> None:
        """Run what is left of a phase; every result is in the ledger before the next one is looked at."""
        tasks = [NodeTask(run.spec, self._campaign, golden) for run in self._store.runs(phase, done=False)]
        with closing(self._pool.run(run_node_task, tasks)) as results:
            for task, result in results:
                done = _lost(result) if isinstance(result, Lost) else result
                self._store.write(task.spec, done.record, None, done.note, done.wall_s)
                self._done += 1
                self._tell()

    def _tell(self) -> None:
        if self._report is not None:
            counts = self._store.counts()
            done = sum(number for _, number, _ in counts.values())
            seconds = time.perf_counter() - self._started
            self._report(Progress(done, self._campaign.count, counts, self._done, seconds))


def _lost(result: Lost) -> RunResult:
    record = {"end": str(End.UNKNOWN), "outcome": "unknown", "reason": result.reason, "success": False}
    return RunResult(record, None, result.reason)


def _golden(store: Store, campaign: NodeCampaign) -> tuple[str, ...]:
    """The output that all golden trials agree on.

    Raises:
        MavfiError: One of them failed; the next sitting would not run it again, so the ledger should be removed.
        BadInputError: They differ.
    """
    found = set()
    for run in store.runs(PHASE_GOLDEN):
        assert run.record is not None
        if run.record["end"] != End.FLOWN:
            raise MavfiError(f"{run.record['reason']}; remove {store.directory} when this is put right")
        found.add(tuple(run.record["outputs"]))
    if len(found) > 1:
        raise BadInputError(
            f"campaign {campaign.name}: the outputs on {campaign.outputs.topic} of {campaign.golden_runs} golden "
            "trials differ, so nothing can be told from them; name what changes by itself in outputs.ignore"
        )
    return next(iter(found))
