"""ROS message definitions, derived from the state table; text only, requires no ROS.

A state `planning.waypoint` becomes the type `mavfi_msgs/PlanningWaypoint`: a `Header` whose stamp is the publication
instant, the sequence `number` of the publication, then the fields of the state with names and types as in the table.
Element fields are arrays of the same name; a header field whose name is also an element field becomes `header_<name>`.
"""

from enum import IntEnum

from mavfi.states import STATES, StateSpec

PACKAGE = "mavfi_msgs"
_TYPES = {"f8": "float64", "f4": "float32", "i4": "int32", "?": "bool"}


class Action(IntEnum):
    """What the world asks of a node, one `mavfi_msgs/Operation` each."""

    RECEIVE = 0  # the kernel receives the publication `number`
    STEP = 1  # the kernel computes; its results get the numbers from `number` on
    PUBLISH = 2  # the result `number` is published
    MARK = 3  # the kernel marks its memory
    ROLLBACK = 4  # the kernel's memory becomes that of the last mark
    STOP = 5  # the setpoint generator abandons its trajectory
    ABANDON = 6  # the setpoint generator skips a way-point
    AGAIN = 7  # the kernel prepares to repeat its last step
    GIVE = 8  # the publication `number` is `value`: one of before the node's restart
    RESUME = 9  # the kernel continues from what was given
    RESET = 10  # the node's kernels are constructed anew
    CHECK = 11  # the detector checks the publication `number`
    ACCEPT = 12  # the detector records the publication `number`


SERVICES = {
    "Drive": """# Lock-step: what a node does next, and what came of the last operation.
mavfi_msgs/Operation[] operations
---
bool due
string[] states
uint64[] numbers
mavfi_msgs/Alarm[] alarms
""",
}
"""Definition of each service of the package, by name."""
_ACTIONS = "\n".join(f"uint8 {action.name} = {action.value}" for action in Action)
_OTHERS = {
    "Operation": f"""# One operation of a kernel or of the detector; state, value: of the number, where that matters;
# publish_us: stamp of what is published at once, -1 = it is held.
{_ACTIONS}
uint8 action
string kernel
uint64 number
int64 time_us
int64 publish_us
string state
uint8[] value
""",
    "Alarm": """# A detector's alarm on one publication.
std_msgs/Header header
uint64 number
string state
string source
string stage
bool abandon_waypoint
bool stop
float64 score
string[] fields
bool hard
""",
}


def type_name(spec: StateSpec) -> str:
    """Message type name of a state, without its package: `planning.waypoint` -> `PlanningWaypoint`."""
    return "".join(word.capitalize() for word in spec.name.replace(".", "_").split("_"))


def header_slots(spec: StateSpec) -> tuple[str, ...]:
    """Message field names of the state's header, in table order."""
    return tuple(f"header_{f.name}" if spec.in_elements(f.name) else f.name for f in spec.header)


def element_slots(spec: StateSpec) -> tuple[str, ...]:
    """Message field names of the state's elements, in table order."""
    return tuple(f.name for f in spec.elements)


def message_text(spec: StateSpec) -> str:
    """Message definition of a state, as in a `.msg` file."""
    lines = [f"# {spec.name}, published by {spec.writer}: {spec.rate}.", "std_msgs/Header header", "uint64 number"]
    lines += [f"{_TYPES[f.dtype]} {slot}  # {f.unit}" for slot, f in zip(header_slots(spec), spec.header, strict=True)]
    slots = zip(element_slots(spec), spec.elements, strict=True)
    lines += [f"{_TYPES[f.dtype]}[] {slot}  # {f.unit}, per {spec.element}" for slot, f in slots]
    return "\n".join(lines) + "\n"


def messages() -> dict[str, str]:
    """Definition of each message of the package, by name."""
    return {type_name(spec): message_text(spec) for spec in STATES.values()} | _OTHERS
