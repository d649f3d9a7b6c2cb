"""Flies a stored run again from its spec, and says whether the same flight came out."""

from dataclasses import dataclass
from pathlib import Path

from mavfi.campaign.plan import RunSpec
from mavfi.campaign.store import Run, Store
from mavfi.campaign.tools import host_tools
from mavfi.campaign.worker import Flight, Task, Tools, fly_task
from mavfi.config import parse
from mavfi.errors import BadInputError
from mavfi.mission import Scenario


@dataclass(frozen=True, slots=True)
class Replay:
    """A run that was flown again.

    Attributes:
        run: The stored run.
        flight: The flight of now.
        digest: Its digest.
        twin: The stored golden run with the same mission and detector; None for golden runs.
    """

    run: Run
    flight: Flight
    digest: str
    twin: Run | None

    @property
    def same(self) -> bool:
        """Whether the flight is bit for bit the stored one."""
        return self.run.record is not None and self.run.record.get("digest") == self.digest


def replay(directory: Path, run_id: str, tools: Tools | None = None) -> Replay:
    """Fly a run again.

    Args:
        directory: Where the campaign's ledger is.
        run_id: The run, or an unambiguous beginning of its id.
        tools: None = the in-process host.

    Raises:
        BadInputError: No such campaign or run, or it is not flown yet.
        SpecMismatchError: The detector's model is no longer the one that the run flew with.
    """
    with Store.open(directory) as store:
        run = store.run(run_id)
        if run.record is None:
            raise BadInputError(f"{directory}: run {run.spec.run_id} is not flown yet")
        flight = fly_again(store, run.spec, tools)
        return Replay(run, flight, flight.log.digest(), golden_twin(store, run.spec))


def fly_again(store: Store, spec: RunSpec, tools: Tools | None = None) -> Flight:
    """Fly any run of a ledger, for its whole log.

    Raises:
        BadInputError: It holds no flights.
    """
    store.require_flights()
    stored = store.meta("identity")["scenarios"][spec.scenario_name]
    template = parse(Scenario, stored, f"ledger, scenario {spec.scenario_name}")
    scenario = template.model_copy(update={"seed": spec.seed})
    models_dir = store.meta("models_dir")
    return fly_task(Task(spec, scenario, tools or host_tools(), None if models_dir is None else Path(models_dir)))


def golden_twin(store: Store, spec: RunSpec) -> Run | None:
    """The stored golden run of the same mission and detector; None for a golden run."""
    if spec.fault is None:
        return None
    wanted = (spec.golden_setting, spec.environment, spec.seed)
    rows = (run for run in store.runs(phase=1) if (run.spec.setting, run.spec.environment, run.spec.seed) == wanted)
    return next(rows, None)
