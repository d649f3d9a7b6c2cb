"""One fault requested by a user: unspecified parts are drawn from the golden run of a mission."""

from mavfi.campaign.samplers.instruction import draw_instruction_faults, instruction_fault
from mavfi.campaign.samplers.memory import draw_memory
from mavfi.detectors.detector import Detector
from mavfi.errors import BadInputError
from mavfi.faults.fault import LIFETIME, Fault, InstructionFault, MemoryFault, RegisterFault, StateFault
from mavfi.faults.levels.sensor.fault import RANDOM, SensorFault
from mavfi.faults.spec import InstructionSite, MemoryRequest, Request, SensorRequest, StateRequest
from mavfi.flight.decide import INLINE, Recovery
from mavfi.flight.fly import fly
from mavfi.flight.host import Flight
from mavfi.flight.sensor_faults import check_read
from mavfi.mission import Scenario
from mavfi.states import DETECTORS, WATCHING


def draw_request(
    scenario: Scenario, request: Request | RegisterFault, seed: int, detector: Detector | None = None,
    recovery: Recovery = INLINE,
) -> tuple[Fault, Flight | None]:  # fmt: skip
    """Draw a fault; also returns the golden flight (without a detector) if one was flown for the draw.

    The detector is flown only if the fault is in its own instructions or memory.

    Raises:
        BadInputError: The mission has no such site.
    """
    if isinstance(request, RegisterFault):
        return request, None  # drawn when it is injected
    if isinstance(request, StateRequest):
        return draw_state(scenario, request, seed)
    if isinstance(request, MemoryRequest):
        in_memory, flown = draw_memory(scenario, request, seed, detector, recovery)
        return in_memory, None if request.kernel in WATCHING else flown
    if isinstance(request, SensorRequest):
        return draw_sensor(scenario, request, seed)
    own = detector if request.kernel in DETECTORS else None
    if isinstance(request, InstructionSite):
        return instruction_fault(scenario, request, own), None
    drawn = draw_instruction_faults(scenario, request, seed=seed, detector=own, recovery=recovery)
    fault = drawn.faults[request.kernel][0]
    if not fault.has_site:
        raise BadInputError(
            f"fault instruction:{request.kernel}: this mission executes no instruction {request.which!r} there; "
            "allowed: a class that it executes"
        )
    return fault, drawn.golden if own is None else None


def draw_state(scenario: Scenario, request: StateRequest, seed: int) -> tuple[StateFault, Flight | None]:
    """Draw a fault in a state; also returns the golden flight if one was flown for the draw."""
    golden = fly(scenario, profile=True) if request.needs_profile else None
    return request.resolve(seed, scenario.autopilot.name, None if golden is None else golden.profile), golden


def draw_sensor(scenario: Scenario, request: SensorRequest, seed: int) -> tuple[SensorFault, Flight | None]:
    """Draw the start of a failure; also returns the golden flight if one was flown for the draw."""
    check_read(request.fault.unit, scenario.flight_controller, scenario.localization.kind)
    if not request.drawn:
        return request.resolve(seed, 0), None
    golden = fly(scenario)
    return request.resolve(seed, round(1e6 * golden.record().flight_time_s)), golden


def seed_of(fault: Fault) -> int | None:
    """The seed that a fault needs in addition to its text, for random choices during the flight; None = none."""
    if isinstance(fault, SensorFault):
        return fault.seed if fault.kind in RANDOM else None
    return fault.seed if isinstance(fault, StateFault) and fault.share < 1.0 else None


def text_of(fault: Fault) -> str | None:
    """The text that names a fault in full, for `mavfi fly --fault`; None = it is in no mission of this host."""
    if isinstance(fault, InstructionFault) and fault.kernel:
        return InstructionSite.text_of(fault)
    if isinstance(fault, SensorFault):
        return SensorRequest.text_of(fault)
    bit = "" if fault.bit is None else f":bit={fault.bit}"
    if isinstance(fault, MemoryFault):
        index = "" if fault.index is None else f"[{fault.index}]"
        return f"memory:{fault.kernel}.{fault.field}{index}{bit}@{fault.time_us / 1e6}"
    if not isinstance(fault, StateFault):
        return None
    state, rest = f"state:{fault.where.state}.{fault.where.field}", ""
    element = "" if fault.where.element is None else f"[{fault.where.element}]"
    for name in ("width", "times", "lasts_s", "share"):
        value = getattr(fault, name)
        if value != LIFETIME[name]:
            rest += f":{name.removesuffix('_s')}={'inf' if value == float('inf') else value}"
    return f"{state}{element}{bit}{rest}@{fault.time_us / 1e6}"
