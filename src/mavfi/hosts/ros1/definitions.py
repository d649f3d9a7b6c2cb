"""ROS message definitions, derived from the state table; text only, requires no ROS.

A state `planning.waypoint` becomes the type `mavfi_msgs/PlanningWaypoint`: a `Header` whose stamp is the publication
instant, the sequence `number` of the publication, then the fields of the state with names and types as in the table.
Element fields are arrays of the same name; a header field whose name is also an element field becomes `header_<name>`.
"""

from mavfi.states import STATES, StateSpec

PACKAGE = "mavfi_msgs"
_TYPES = {"f8": "float64", "f4": "float32", "i4": "int32", "?": "bool"}

SERVICES = {
    "Drive": """# Lock-step: what a node's kernels do next, and what came of the last operation.
mavfi_msgs/Operation[] operations
---
bool due
string[] states
uint64[] numbers
""",
    "Recall": """# Asks a node for a value that it has published or consumed, as it was on its topic.
string state
uint64 number
---
bool held
uint8[] value
""",
}
"""Definition of each service of the package, by name."""
_OTHERS = {
    "Operation": """# One operation of one kernel; state: of the number, where that matters;
# publish_us: stamp of what is published at once, -1 = it is held.
uint8 RECEIVE = 0
uint8 STEP = 1
uint8 PUBLISH = 2
uint8 MARK = 3
uint8 ROLLBACK = 4
uint8 STOP = 5
uint8 ABANDON = 6
uint8 AGAIN = 7
uint8 RECALL = 8
uint8 RESUME = 9
uint8 RESET = 10
uint8 FORGET = 11
uint8 BYPASS = 12
uint8 action
string kernel
uint64 number
int64 time_us
int64 publish_us
string state
""",
    "Verdict": """# What a detector says of one publication.
std_msgs/Header header
uint64 number
string state
bool raised
bool withheld
string source
string stage
bool abandon_waypoint
bool stop
float64 score
string[] fields
bool hard
""",
    "Recompute": """# A detector's request: some kernels put their memory back, and one of them computes again.
std_msgs/Header header
string kind
string stage
string kernel
string[] restores
""",
    "Bypass": """# Whether the gate is down: nodes in front of it publish to its consumers themselves.
std_msgs/Header header
bool on
""",
    "Injection": """# What an injector did.
std_msgs/Header header
string state
string record
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
