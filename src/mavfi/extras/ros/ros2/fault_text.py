"""Faults in ROS 2 messages as text: what `mavfi ros run --fault` and campaigns on stacks read.

    topic:/scan ranges[17] bit=30 @n=100
    topic:/cmd_vel linear.x set=nan times=5 @10
    topic:/odom drop @10..12
    service:/add response sum bit=10

The site, a part of a call (`request`, `response`) or the receiving side (`take`), a field, then operation and trigger
in the words of `mavfi.faults.changes`.
"""

from mavfi.errors import BadInputError
from mavfi.extras.ros.ros2.graph import absolute
from mavfi.extras.ros.ros2.interposer.page import InterposedFault, Side
from mavfi.faults.changes import parse_change
from mavfi.faults.operations import OPERATIONS

FORM = "topic:NAME [take] [FIELD] OPERATION [times=N] [every=N] [share=P] [@WHEN]"
SERVICE_FORM = "service:NAME request|response [FIELD] OPERATION ..."
_SIDES_OF_TOPICS: dict[str, Side] = {"": "publish", "publish": "publish", "take": "take"}
_SIDES_OF_SERVICES: dict[str, Side] = {"request": "take_request", "response": "send_response"}
"""Where each part of a call is changed: in the server's process."""
_OPTIONS = ("bit", "times", "every", "share", "lasts", *OPERATIONS)


def parse_fault(text: str, seed: int = 0) -> InterposedFault:
    """The fault of a text.

    Raises:
        BadInputError: It has another form; the message says which are allowed.
    """
    try:
        return _parse(text.split(), seed)
    except BadInputError as error:
        raise BadInputError(f"fault {text!r}: {error}") from None


def side_of(kind: str, part: str) -> Side:
    """Where a message is changed.

    Args:
        kind: "topic" or "service".
        part: "", "publish" or "take" of a topic; "request" or "response" of a service.

    Raises:
        BadInputError: There is no such part.
    """
    if kind == "service":
        if part not in _SIDES_OF_SERVICES:
            raise BadInputError(f"side {part!r} of a service: allowed: request, response")
        return _SIDES_OF_SERVICES[part]
    if part not in _SIDES_OF_TOPICS:
        raise BadInputError(f"side {part!r}: allowed: publish (in the process that sends), take (in one that receives)")
    return _SIDES_OF_TOPICS[part]


def _parse(words: list[str], seed: int) -> InterposedFault:
    # The site, and which part of it.
    kind, _, name = (words or [""])[0].partition(":")
    if kind not in ("topic", "service") or not name:
        raise BadInputError(f"not understood; allowed: {FORM}, or {SERVICE_FORM}")
    words = words[1:]
    part = ""
    if words and words[0] in (*_SIDES_OF_TOPICS, *_SIDES_OF_SERVICES):
        part = words.pop(0)
    side = side_of(kind, part)

    # The trigger at the end, the field if the next word is no operation.
    instant = ""
    if words and words[-1].startswith("@"):
        instant = words.pop()[1:]
    field = ""
    if words and words[0].partition("=")[0] not in _OPTIONS:
        field = words.pop(0)
    return InterposedFault(absolute(name), field, parse_change(words, instant), side, seed)
