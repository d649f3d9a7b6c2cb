"""The faults of the demo, their flights, and what happened in these, in a sentence."""

from collections.abc import Sequence
from dataclasses import dataclass

from mavfi.api import fly
from mavfi.errors import BadInputError
from mavfi.flight.host import Flight
from mavfi.mission import MissionSpec, MissionStatus
from mavfi.record import FlightLog, Injection
from mavfi.report.explain import after_death
from mavfi.report.flight_result import FlightResult
from mavfi.report.numbers import corruption, outcome, signed_percent

MISSION = MissionSpec(environment="dense", seed=10007)
DETECTOR = "recommended"


@dataclass(frozen=True, slots=True)
class Demo:
    """A fault of the demo.

    Attributes:
        title: What is wrong, in plain words.
        fault: As for `mavfi fly --fault`.
        fault_seed: As for `mavfi fly --fault-seed`.
    """

    title: str
    fault: str
    fault_seed: int = 0

    @property
    def command(self) -> str:
        """The command that repeats its flights."""
        from mavfi.report.html.flight_page import fly_command  # needs an extra, which the flights do not

        fault_seed = None
        if self.fault_seed:
            fault_seed = self.fault_seed
        return fly_command(MISSION, self.fault, fault_seed, DETECTOR, None, None)

    def fly(self) -> FlightResult:
        """Fly the mission without the fault, with it, and with it under the detector."""
        return fly(MISSION, fault=self.fault, fault_seed=self.fault_seed, detector=DETECTOR)


DEMOS = (
    Demo("The flag for an obstacle ahead is lost", "state:perception.collision_status.collision", 1),
    Demo("The number of a new trajectory is wrong", "state:planning.trajectory.trajectory_seq", 1),
    Demo("One bit flips in an instruction of the planner", "instruction:planner", 1),
    Demo("One bit flips in an instruction of the map", "instruction:octomap", 2),
    Demo("One word of the map changes its sign", "memory:octomap.log_odds[682813]:bit=31@27"),
    Demo("One bit of a way-point flips", "state:planning.waypoint.x:bit=62@20"),
    Demo("Commands are no numbers for two seconds", "state:control.command.vx:set=nan@10..12"),
    Demo("The gyro is stuck", "sensor:gyro:stuck@10"),
    Demo("A new trajectory never arrives", "message:planning.trajectory:drop@27.2..27.3"),
    Demo(
        "Two faults: the position sensor is stuck, commands are no numbers",
        "sensor:position:stuck:lasts=5@19 + state:control.command.vx:set=nan@20..22",
    ),
)


def demo(number: int) -> Demo:
    """Find a fault of the demo by its number, from 1.

    Raises:
        BadInputError: There is none.
    """
    if not 1 <= number <= len(DEMOS):
        raise BadInputError(f"demo {number}: not known; allowed: 1 to {len(DEMOS)}")
    return DEMOS[number - 1]


@dataclass(frozen=True, slots=True)
class FlownDemo:
    """A fault of the demo with its flights.

    Attributes:
        number: Its number, from 1.
        demo: The fault.
        result: The flight under the detector, with the golden run and the flight without the detector.
    """

    number: int
    demo: Demo
    result: FlightResult

    @property
    def golden(self) -> Flight:
        """The flight without the fault."""
        assert self.result.golden is not None  # there is a fault
        return self.result.golden

    @property
    def unwatched(self) -> Flight:
        """The flight with the fault, without the detector."""
        assert self.result.unwatched is not None  # the fault is not in the detector
        return self.result.unwatched

    @property
    def is_lost(self) -> bool:
        """Whether the fault loses the mission."""
        return self.unwatched.log.status is not MissionStatus.SUCCESS

    @property
    def is_recovered(self) -> bool:
        """Whether the detector brings a lost mission back."""
        return self.is_lost and self.result.status is MissionStatus.SUCCESS

    @property
    def sentence(self) -> str:
        """What the fault was, how the mission ended, and how it ended under the detector."""
        log = self.unwatched.log
        causes = ", ".join(_cause(injection) for injection in log.injections)
        ending = _ending(log, self.golden.log)
        if log.kernel is not None and log.kernel.detail:
            ending = f"the kernel fails ({log.kernel.detail}), {after_death(log)}, and {ending}"
        return f"{causes[0].upper()}{causes[1:]}: {ending}; with {DETECTOR}: {self._ending_with_detector()}."

    def _ending_with_detector(self) -> str:
        log = self.result.log
        if log.digest() == self.golden.log.digest():
            return "it is flown as without the fault, bit for bit"
        if log.status is self.unwatched.log.status and _duration(log) == _duration(self.unwatched.log):
            return "it ends the same way"
        ending = _ending(log, self.golden.log)
        if log.kernel is not None and log.kernel.detail and log.meta["scenario"].get("dead_node") == "readback":
            return f"its node reads its last outputs back, and {ending}"
        return ending


def _cause(injection: Injection) -> str:
    """What was done to which value, and when."""
    instant = f"{injection.time_s:.2f} s"
    if injection.level == "sensor":
        duration = injection.details.get("model", "to the end")
        return f"{injection.site} from {instant} on, {duration}"
    change = outcome(injection, digits=4)
    if injection.bit is None:
        return f"at {instant} {corruption(injection)} hits {injection.site} ({change})"
    value = injection.site
    if injection.level == "instruction":
        value = f"a result in {injection.site}"
    return f"at {instant} bit {injection.bit} of {value} flips ({change})"


def _ending(log: FlightLog, golden: FlightLog) -> str:
    """How the mission ended, and the flight time compared with that of the golden run."""
    duration = _duration(log)
    if log.status is not MissionStatus.SUCCESS:
        return f"the mission is lost after {duration:.1f} s ({log.status.words})"
    difference = duration / _duration(golden) - 1.0
    if difference == 0.0:
        return f"the goal is reached after {duration:.1f} s, as without the fault"
    return f"the goal is reached after {duration:.1f} s ({signed_percent(difference)})"


def _duration(log: FlightLog) -> float:
    """Flight time (s)."""
    return float(log.column("time")[-1])


def headline(demos: Sequence[FlownDemo]) -> str:
    """How many of the faults lose the mission, and how many of these missions the detector brings back."""
    lost = sum(flown.is_lost for flown in demos)
    recovered = sum(flown.is_recovered for flown in demos)
    mission = f"a mission of {_duration(demos[0].golden.log):.1f} s ({MISSION.environment}, seed {MISSION.seed})"
    return f"{lost} of {len(demos)} faults lose {mission}; the detector {DETECTOR} brings {recovered} of them back."
