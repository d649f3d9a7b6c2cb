"""Public Python API: fly missions, inject faults, run campaigns, query views; shared with the command line.

    import mavfi

    result = mavfi.fly(environment="dense", seed=10007, fault="state:planning.waypoint.x:bit=62@20.0")
    result.effect, result.quality, result.frame

    runs = mavfi.run("smoke", "out/smoke")
    mavfi.table(runs, "success")

Names are imported from `mavfi`, not from this module.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from mavfi.config import parse as parse_config
from mavfi.detectors.detector import Detector, require_detector
from mavfi.errors import BadInputError, naming_extra
from mavfi.faults.fault import Fault
from mavfi.flight.compose import prepare, resolve
from mavfi.flight.host import ArmSetup, Flight, Host, host_for
from mavfi.flight.mission_flights import LocalHost
from mavfi.levels.level import Request, parse
from mavfi.mission import MissionSpec, Scenario
from mavfi.mission_keys import MissionKeys, MissionKeysWithoutSeed, check_keys, takes_mission_keys
from mavfi.plugins import allow_typed
from mavfi.report.flight_result import FlightResult, FlownAs

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from mavfi.analysis.comparison import CampaignComparison
    from mavfi.analysis.runs import Runs
    from mavfi.analysis.table import Table
    from mavfi.campaign.config import Campaign
    from mavfi.campaign.executors.executor import Executor
    from mavfi.campaign.ledger import Progress


@takes_mission_keys
def fly(
    mission: MissionSpec | None = None,
    *,
    fault: Fault | str | None = None,
    fault_seed: int = 0,
    detector: Detector | str | None = None,
    profile: str = "paper",
    models: Path | str | None = None,
    detector_options: Mapping[str, Any] | None = None,
    **options: Unpack[MissionKeys],
) -> FlightResult:
    """Fly one mission; with a fault, also its golden run; with a fault and a detector, also the fault without detector.

    Args:
        mission: The mission; None = as given by the options.
        fault: A fault, or its text as for `mavfi fly --fault`; properties omitted in the text are drawn.
        fault_seed: Seed of that draw.
        detector: A detector or its name; None = no detector.  An object is called in this process, so that it has its
            memory of the flight afterwards; one that is named and not part of mavfi, in a child process.
        profile: Profile of a named detector.
        models: Folder of trained models; None = the shipped ones.
        detector_options: Options of a named detector, e.g. {"rules": [1, 3]} of acceptance.
        options: Keys of the mission, e.g. environment, seed, wind; they override those of `mission`.

    Returns:
        Status, record, quality, effect, log, and the frame of the flight; deterministic for equal arguments.  A
        notebook shows it in three dimensions; see also `FlightResult.plot` and `FlightResult.html`.

    Raises:
        BadInputError: Unknown or inconsistent arguments.
    """
    if fault_seed and not isinstance(fault, str):
        raise BadInputError(f"fault_seed: {fault_seed}: no fault to draw; allowed: with the text of a fault")
    spec = _spec(fly, mission, options)
    call = ""
    if detector is None or isinstance(detector, str):  # an object's class may be known to the caller's code alone
        arguments = {"fault": fault, "fault_seed": fault_seed, "detector": detector, "models": models}
        call = _call(spec, arguments | {"detector_options": detector_options}, profile)
    else:
        require_detector(detector)
    allow_typed([detector])
    if detector_options and not isinstance(detector, str):
        raise BadInputError(f"detector_options: {detector_options!r}: allowed: with the name of a detector")
    setup = prepare(spec, detector, profile, _path(models), detector_options)
    if isinstance(fault, str):
        request: Request | Fault | None = parse(fault, spec.localization)
    else:
        request = fault
    return fly_request(setup, request, fault_seed, without_detector=resolve(spec), command=call)


@takes_mission_keys
def draw(
    fault: str, mission: MissionSpec | None = None, *, seed: int = 0, **options: Unpack[MissionKeysWithoutSeed]
) -> Fault:
    """Complete a fault by drawing the properties omitted in its text, from the golden run of a mission.

    Args:
        fault: As for `mavfi fly --fault`.
        mission: The mission; None = as given by the options.
        seed: Seed of the draw.
        options: Keys of the mission, all but its seed; they override those of `mission`.

    Raises:
        BadInputError: Invalid text, or the mission has no such site.
    """
    spec = _spec(draw, mission, options)
    return parse(fault, spec.localization).draw(ArmSetup(resolve(spec)), seed)[0]


def run(
    campaign: "Campaign | str | Path",
    directory: Path | str,
    *,
    workers: int = 2,
    models: Path | str | None = None,
    executor: "Executor | None" = None,
    extend: bool = False,
    progress: "Callable[[Progress], None] | None" = None,
) -> "Runs":
    """Fly a campaign or its remaining runs, and load its ledger.

    Args:
        campaign: A campaign, the name of a shipped one, or a path.
        directory: Folder of its new or existing ledger.
        workers: Number of processes; the ledger does not depend on it.
        models: Folder of trained models; None = that of the ledger, or the shipped ones.
        executor: Alternative executor, e.g. a `mavfi.extras.dask.executor.DaskExecutor`.
        extend: Whether the ledger may be that of a smaller campaign, whose runs are kept.
        progress: Called after every run; None = one line is updated in notebooks and terminals.

    Raises:
        BadInputError: See `campaign.begin` and `campaign.run.run_campaign`.
    """
    with naming_extra("mavfi.run"):  # before the flights
        from mavfi.analysis.runs import Runs
    from mavfi.campaign.begin import begin, check_names, check_null_runs
    from mavfi.campaign.config import Campaign, load_campaign
    from mavfi.campaign.executors.local import LocalExecutor
    from mavfi.campaign.run import run_campaign
    from mavfi.report.progress import Bar

    if isinstance(campaign, Campaign):
        loaded_campaign = campaign
    else:
        loaded_campaign = load_campaign(campaign)
        check_names(loaded_campaign, str(campaign))
    check_null_runs(loaded_campaign, Path(directory))
    with Bar(loaded_campaign.name, "runs", prints_lines=False) as bar:
        run_campaign(
            begin(loaded_campaign, Path(directory), models_dir=_path(models), extend=extend),
            Path(directory),
            executor=executor or LocalExecutor(workers),
            extend=extend,
            progress=progress or bar.show_campaign,
        )
    return Runs.read(Path(directory))


def load(directory: Path | str) -> "Runs":
    """Load the runs of a ledger; `frame` has one row per run.

    Raises:
        BadInputError: The folder has no ledger.
    """
    with naming_extra("mavfi.load"):
        from mavfi.analysis.runs import Runs

    return Runs.read(Path(directory))


def table(runs: "Runs", view: str) -> "Table":
    """Compute a table of a report.

    Args:
        runs: See `load`.
        view: Name of the view; `mavfi report DIR --view list` lists those that apply.

    Raises:
        BadInputError: Unknown view, or these runs have nothing to show in it.
    """
    from mavfi.analysis.views import table_asked_for

    return table_asked_for(runs, view)


def figure(runs: "Runs", name: str) -> "Figure":
    """Draw a figure of a report as a matplotlib figure, for display in a notebook or `savefig`.

    Args:
        runs: See `load`.
        name: E.g. "success", "flight_time", "states"; an unknown name is refused with all that there are.

    Raises:
        BadInputError: Unknown figure, or no data for it.
    """
    from mavfi.report.figures import figure as figure_of

    return figure_of(runs, name)


def compare(runs_a: "Runs", runs_b: "Runs") -> "CampaignComparison":
    """Compare two campaigns: differences of failures, flight time and energy, B - A, in pairs where runs are shared.

    Args:
        runs_a: See `load`.
        runs_b: The other one.

    Raises:
        BadInputError: They have nothing in common.
    """
    from mavfi.analysis.comparison import compare as compare_runs

    return compare_runs(runs_a, runs_b)


def fly_request(
    setup: ArmSetup,
    fault: Request | Fault | None,
    seed: int,
    without_detector: Scenario,
    own_host: Host | None = None,
    command: str = "",
) -> FlightResult:
    """Fly the golden run and a fault; a requested fault is drawn first, from the golden run.

    Args:
        setup: Mission, detector and recovery.
        fault: The fault, or a request for one; None = the golden run only.
        seed: Seed of the draw.
        without_detector: The mission without the detector and its mission keys, in which the fault is flown as well.
        own_host: Flies the mission; None = the host of the fault.
        command: What repeats the flight, for its page.

    Raises:
        BadInputError: The mission has no such site.
    """
    # Draw the fault; the golden run from which it was drawn is used again below.
    golden = None
    if fault is not None and not isinstance(fault, Fault):
        fault, golden = fault.draw(setup, seed)
    if own_host is not None:
        golden = None  # it was flown in this process
    host = own_host or host_for(fault)
    flown_as = None
    if isinstance(host, LocalHost) and host.supports_fast_forward:  # in our simulator, not in another one
        flown_as = FlownAs(setup, without_detector, command)
    if setup.make_detector is None:
        flight, golden = _flown(host, setup, fault, golden)
        return FlightResult(setup.scenario, flight, golden, fault, flown_as=flown_as)

    # Fly under the detector, and once more without it.
    flight, watched_golden = _flown(host, setup, fault)
    unwatched = None
    if fault is not None and not fault.in_detector:  # those exist only with the detector
        if without_detector != setup.scenario:
            golden = None  # it is the golden run of another mission
        unwatched, _ = _flown(host, ArmSetup(without_detector), fault, golden)
    return FlightResult(setup.scenario, flight, watched_golden, fault, setup.label, unwatched, flown_as)


def _flown(
    host: Host, setup: ArmSetup, fault: Fault | None, golden: Flight | None = None
) -> tuple[Flight, Flight | None]:
    """Return the flight and its golden run, which may be known; without a fault, the golden run and None."""
    arms = {"": setup, "golden": replace(setup, observers=())}  # observers see the flight with the fault only
    flights: Any = host.mission(arms, fast_forward=False)  # each host has its own type
    if fault is None:
        return golden or flights.golden(""), None
    golden = golden or flights.golden("golden")
    flights.register_golden("", golden)
    ((_, flight),) = flights.injected([("", fault)])
    if isinstance(flight, Exception):
        raise flight
    return flight, golden


def _call(spec: MissionSpec, arguments: dict[str, Any], profile: str) -> str:
    """The call of `fly` with a mission and those of its arguments that were given."""
    keys = spec.model_dump(exclude_unset=True)
    keys |= {name: value for name, value in arguments.items() if value}
    if arguments["detector"]:
        keys["profile"] = profile
    return f"mavfi.fly({', '.join(f'{name}={value!r}' for name, value in keys.items())})"


def _spec(function: Callable[..., Any], mission: MissionSpec | None, options: MissionKeysWithoutSeed) -> MissionSpec:
    """The mission with the options of a function in place of its own keys."""
    check_keys(function, options)
    allow_typed(options.values())
    keys = {}
    if mission is not None:
        keys = mission.model_dump(exclude_unset=True)
    return parse_config(MissionSpec, {**keys, **options}, "mission")


def _path(folder: Path | str | None) -> Path | None:
    """A folder as a `Path`; None stays None."""
    if folder is None:
        return None
    return Path(folder)
