"""Memory of the acceptance test: one record of earlier publications, updated by compiled functions.

The record starts with the numbers of `MissionLimits`, so that rules receive limits and memory in one argument: each
argument costs some 60 ns per call from Python.  A checked header is stored as the candidate; after acceptance the next
call commits it as the last publication, so that each publication costs one call.

Trajectory points are stored in blocks, shape (KEPT, capacity, 11); the record holds their numbers and lengths.
"""

import numpy as np

from mavfi.detectors.limits import NUMBERS, MissionLimits
from mavfi.numerics.jit import kernel_jit
from mavfi.states import STATES

KEPT = 3
"""Trajectories that a way-point may refer to: the one in force, the pending one, and one spare."""
COUNTERS = 4
CAPACITY = 2048
"""Initial capacity of a block, in trajectory points; grows if needed."""
STATUS, PATH, TRAJECTORY = (
    STATES[name].header_dtype for name in ("perception.collision_status", "planning.path", "planning.trajectory")
)
WAYPOINT, COMMAND, TRACKING = (
    STATES[name].header_dtype for name in ("planning.waypoint", "control.command", "control.tracking")
)
_NONE, OF_WAYPOINT, OF_COMMAND, OF_TRACKING = range(4)
_WAYPOINT_SIZE, _COMMAND_SIZE, _TRACKING_SIZE = WAYPOINT.itemsize, COMMAND.itemsize, TRACKING.itemsize
_SHARE_OF_LATENCY = 0.7
"""Least planning time before a path is published / the planner's latency."""
_JITTER_US = 300_000
"""Largest planning time in excess of that."""
_LONG_AGO = -(1 << 62)

_LIMITS = [(name, NUMBERS[name]) for name in NUMBERS.names or ()]
_HEADERS = {
    "last_status": STATUS, "last_path": PATH, "last_trajectory": TRAJECTORY, "last_waypoint": WAYPOINT,
    "last_command": COMMAND, "last_tracking": TRACKING,
}  # fmt: skip
_REMEMBERED = [
    *((name, "u1", (dtype.itemsize,)) for name, dtype in _HEADERS.items()),
    ("end", "f8", (3,)), ("ended", "?"),
    ("changes", "i8"), ("times", "i8", (COUNTERS,)), ("counters", "i8", (COUNTERS,)),
    ("stored", "i8"), ("numbers", "i8", (KEPT,)), ("counts", "i8", (KEPT,)),
    ("switched", "?"), ("fresh", "?"),
]  # fmt: skip
_WORK = [
    ("planning_us", "i8"), ("blocks", "i8", (KEPT,)), ("candidate", "u1", (_WAYPOINT_SIZE,)), ("candidate_of", "i8"),
    ("accepted", "?"),
]  # fmt: skip
RECORD = np.dtype([*_LIMITS, *_REMEMBERED, *_WORK])
"""The record.

- Limits: see `MissionLimits.numbers`.
- Last published headers, as bytes: `last_status` and so on; 0 before the first.
- `end`: last vertex of the path (m), if it has one (`ended`).
- `counters`, `times`: the latest values of the collision counter, oldest first, and the times of the changes (us);
  `changes` is their number.
- `numbers`, `counts`: number and length of the latest trajectories with points, oldest first; `stored` is how many.
- `switched`, `fresh`: whether a way-point has been published since the last command, and since the last tracking
  report.
- Work: `planning_us`, the least time from the planner's start to its path (us); block index of each stored trajectory;
  the candidate, its state, and whether it was accepted.
"""
_FIRST, _END = len(_LIMITS), len(_LIMITS) + len(_REMEMBERED)
MEMORY = slice(RECORD.fields[RECORD.names[_FIRST]][1], RECORD.fields[RECORD.names[_END]][1])  # type: ignore[index]
"""Bytes of the record that form the memory."""


def new_record(limits: MissionLimits) -> np.ndarray:
    """The record at the start of a flight. Shape (1,)."""
    known = np.zeros(1, RECORD)
    for name in NUMBERS.names or ():
        known[name] = limits.numbers()[name]
    known["planning_us"] = int(_SHARE_OF_LATENCY * 1e6 * limits.planner_latency)
    forget(known)
    return known


def named(known: np.ndarray) -> dict[str, np.ndarray]:
    """The memory by name, headers by field: the arrays themselves, not copies."""
    found: dict[str, np.ndarray] = {}
    for name in RECORD.names[_FIRST:_END] if RECORD.names else ():
        array = known[name].reshape(-1)
        if name in _HEADERS:
            header = array.view(_HEADERS[name])
            found |= {f"{name}.{field}": header[field] for field in header.dtype.names or ()}
        else:
            found[name] = array
    return found


def forget(known: np.ndarray) -> None:
    """Reset the memory at the start of a flight."""
    known.view(np.uint8)[MEMORY] = 0
    known["switched"] = known["fresh"] = True
    known["changes"], known["times"][0, 0] = 1, _LONG_AGO
    known["blocks"], known["accepted"] = range(KEPT), False


@kernel_jit
def settle(known: np.ndarray) -> None:
    """Commit the candidate, if accepted, as the last publication of its state."""
    own = known[0]
    if not own["accepted"]:
        return
    own["accepted"] = False
    if own["candidate_of"] == OF_WAYPOINT:
        own["last_waypoint"][:] = own["candidate"][:_WAYPOINT_SIZE]
        own["switched"] = own["fresh"] = True
    elif own["candidate_of"] == OF_COMMAND:
        own["last_command"][:] = own["candidate"][:_COMMAND_SIZE]
        own["switched"] = False
    else:
        own["last_tracking"][:] = own["candidate"][:_TRACKING_SIZE]
        own["fresh"] = False


@kernel_jit
def propose(header: np.ndarray, of: int, known: np.ndarray) -> None:
    """Store a header as the candidate; `of` identifies its state."""
    own = known[0]
    content = header.view(np.uint8)
    own["candidate"][: len(content)] = content
    own["candidate_of"] = of


@kernel_jit
def used(count: int, least: int, most: int) -> int:
    """A number of entries within its bounds: a corrupted one must not become an index."""
    return min(max(count, least), most)


@kernel_jit
def note_status(header: np.ndarray, now: int, known: np.ndarray) -> None:
    """Record a collision status published at `now` (us)."""
    own = known[0]
    counter, count = int(header[0]["future_collision_seq"]), used(own["changes"], 1, COUNTERS)
    times, counters = own["times"], own["counters"]
    if counter != counters[count - 1]:
        if count == COUNTERS:
            times[:-1], counters[:-1] = times[1:].copy(), counters[1:].copy()
            count -= 1
        times[count], counters[count] = now, counter
        own["changes"] = count + 1
    own["last_status"][:] = header.view(np.uint8)


@kernel_jit
def answerable(now: int, known: np.ndarray) -> np.ndarray:
    """Collision counters that a path at `now` (us) can answer: the one known when the planner started, and later."""
    own = known[0]
    began = now - own["planning_us"]
    found, count = np.zeros(COUNTERS + 1, np.int64), 0
    changes = used(own["changes"], 1, COUNTERS)
    for index in range(changes):
        if own["times"][index] <= began:
            found[0], count = own["counters"][index], 1
    for index in range(changes):
        if own["times"][index] > began - _JITTER_US:
            found[count] = own["counters"][index]
            count += 1
    return found[:count]


@kernel_jit
def note_path(header: np.ndarray, vertices: np.ndarray, known: np.ndarray) -> None:
    """Record a published path; vertices (m) have shape (n, 3)."""
    own = known[0]
    own["ended"], own["end"][:] = len(vertices) > 0, 0.0
    if len(vertices) > 0:
        own["end"][:] = vertices[len(vertices) - 1]
    own["last_path"][:] = header.view(np.uint8)


@kernel_jit
def note_trajectory(header: np.ndarray, points: np.ndarray, known: np.ndarray, blocks: np.ndarray) -> None:
    """Record a published trajectory; points have shape (n, 11) and fit into a block."""
    own = known[0]
    own["last_trajectory"][:] = header.view(np.uint8)
    if len(points) == 0:
        return
    number, stored, places = int(header[0]["trajectory_seq"]), used(own["stored"], 0, KEPT), own["blocks"]
    drop = 0 if stored == KEPT else stored
    for index in range(stored):
        if own["numbers"][index] == number:
            drop = index
    place, last = places[drop], stored - 1 if drop < stored else stored
    for index in range(drop, last):
        own["numbers"][index], own["counts"][index] = own["numbers"][index + 1], own["counts"][index + 1]
        places[index] = places[index + 1]
    own["numbers"][last], own["counts"][last], places[last] = number, len(points), place
    own["stored"] = last + 1
    for row in range(len(points)):  # an assigned slice would call functions with memory of their own
        for column in range(points.shape[1]):
            blocks[place, row, column] = points[row, column]


@kernel_jit
def points_of(number: int, known: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    """Points of a stored trajectory. Shape (n, 11); (0, 11) if unknown."""
    own = known[0]
    for index in range(used(own["stored"], 0, KEPT)):
        if own["numbers"][index] == number:
            return blocks[own["blocks"][index], : own["counts"][index]]
    return blocks[0, :0]


@kernel_jit
def newest(known: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    """Points of the latest stored trajectory. Shape (n, 11); (0, 11) if there is none."""
    last = used(known[0]["stored"], 0, KEPT) - 1
    return blocks[0, :0] if last < 0 else blocks[known[0]["blocks"][last], : known[0]["counts"][last]]
