"""Flies a stored run again from its spec, and says whether the same flight came out."""

from dataclasses import dataclass
from pathlib import Path

from mavfi.campaign.mission import MissionPlan, host_of, setup_of
from mavfi.campaign.plan import RunSpec, arms_of
from mavfi.campaign.run import stored_campaign
from mavfi.campaign.store import Run, Store
from mavfi.errors import BadInputError
from mavfi.hosts.host import ArmSetup, Flight, Host, Recorded


@dataclass(frozen=True, slots=True)
class Replay:
    """A run that was flown again.

    Attributes:
        run: The stored run.
        flight: The new flight, and its digest.
        golden: The stored golden run of the same mission and arm; None for golden runs.
    """

    run: Run
    flight: Flight
    digest: str
    golden: Run | None

    @property
    def same(self) -> bool:
        """Whether the flight is bit for bit the stored one."""
        return self.run.record is not None and self.run.record.digest == self.digest


def replay(directory: Path, run_id: str) -> Replay:
    """Fly a run again, named by an unambiguous beginning of its id.

    Raises:
        BadInputError: No such campaign or run, it is not flown yet, or its host cannot fly it again.
        SpecMismatchError: The detector's model is no longer the one that the run flew with.
    """
    with Store.open(directory) as store:
        run = store.run(run_id)
        if run.record is None:
            raise BadInputError(f"{directory}: run {run.spec.run_id} is not flown yet")
        flight = fly_again(store, run.spec)
        return Replay(run, flight, flight.log.digest(), store.golden_of(run.spec))


def fly_again(store: Store, spec: RunSpec) -> Flight:
    """Fly any run of a ledger, for its whole log; errors as of `replay`."""
    host, setup = setup_again(store, spec)
    flights = host.mission({spec.arm: setup}, fast_forward=False)
    flown: Recorded | Exception
    if spec.fault is None:
        flown = flights.golden(spec.arm)
    else:
        _, flown = next(flights.injected([(spec.arm, spec.fault)]))
    if isinstance(flown, Exception):
        raise flown
    assert isinstance(flown, Flight)  # as every deterministic host gives it
    return flown


def setup_again(store: Store, spec: RunSpec) -> tuple[Host, ArmSetup]:
    """The host of a run, and the setup of the run's arm; errors as of `replay`."""
    campaign = stored_campaign(store)
    host = host_of(campaign)
    if not host.deterministic:
        raise BadInputError(f"{store.directory}: host {host.name} is not deterministic: runs cannot be flown again")
    arm = next(arm for arm in arms_of(campaign) if arm.name == spec.arm)
    models_dir = store.meta("models_dir")
    mission = MissionPlan(
        campaign, *spec.world, None if models_dir is None else Path(models_dir), store.meta("identity")["models"]
    )
    return host, setup_of(mission, arm, host)
