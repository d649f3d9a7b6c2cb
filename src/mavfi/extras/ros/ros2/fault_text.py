"""Faults in ROS 2 messages as text: what `mavfi ros run --fault` and campaigns on stacks read.

    topic:/scan ranges[17] bit=30 @n=100
    topic:/cmd_vel linear.x set=nan times=5 @10
    topic:/odom drop @10..12
    service:/add response sum bit=10

The site, a part of a call (`request`, `response`) or the receiving side (`take`), a field, then operation and trigger
in the words of `mavfi.faults.operations`.
"""

from typing import NamedTuple

from mavfi.errors import BadInputError
from mavfi.extras.ros.ros2.graph import absolute
from mavfi.extras.ros.ros2.interposer.page import InterposedFault, Side
from mavfi.faults.changes import parse_change
from mavfi.faults.operations import OPERATIONS

FORM = "topic:NAME [take] [FIELD] OPERATION [times=N] [every=N] [share=P] [@WHEN]"
SERVICE_FORM = "service:NAME request|response [FIELD] OPERATION ..."
_PARTS: dict[str, tuple[Side, Side]] = {
    "request": ("take_request", "send_request"),
    "response": ("send_response", "take_response"),
}
"""Parts of a call: where the server's process changes them, and where the client's does."""
_OPTIONS = ("bit", "times", "every", "share", *OPERATIONS)


class MessageSite(NamedTuple):
    """Where a fault is.

    Attributes:
        name: Of the topic or service.
        side: As in `SIDES`.
        is_service: Whether it is a service.
    """

    name: str
    side: Side
    is_service: bool


def parse_fault(text: str, seed: int = 0) -> InterposedFault:
    """The fault of a text.

    Raises:
        BadInputError: It has another form; the message says which are allowed.
    """
    try:
        return _parse(text.split(), seed)
    except BadInputError as error:
        raise BadInputError(f"fault {text!r}: {error}") from None


def site_of(kind: str, name: str, part: str, *, of_client: bool = False) -> MessageSite:
    """The site of a fault.

    Args:
        kind: "topic" or "service".
        name: Of the topic or service.
        part: "", "publish" or "take" of a topic; "request" or "response" of a service.
        of_client: Whether a call is changed in the client's process, not in the server's.

    Raises:
        BadInputError: There is no such part.
    """
    name = absolute(name)
    if kind == "topic":
        if part not in ("", "publish", "take"):
            raise BadInputError(
                f"side {part!r}: allowed: publish (in the process that sends), take (in one that receives)"
            )
        side: Side = "publish"
        if part == "take":
            side = "take"
        return MessageSite(name, side, is_service=False)
    if part not in _PARTS:
        raise BadInputError(f"side {part!r} of a service: allowed: request, response")
    return MessageSite(name, _PARTS[part][int(of_client)], is_service=True)


def _parse(words: list[str], seed: int) -> InterposedFault:
    # The site, and which part of it.
    kind, _, name = (words or [""])[0].partition(":")
    if kind not in ("topic", "service") or not name:
        raise BadInputError(f"not understood; allowed: {FORM}, or {SERVICE_FORM}")
    words = words[1:]
    part = ""
    if words and words[0] in ("publish", "take", *_PARTS):
        part = words.pop(0)
    site = site_of(kind, name, part)

    # The trigger at the end, the field if the next word is no operation.
    instant = ""
    if words and words[-1].startswith("@"):
        instant = words.pop()[1:]
    field = ""
    if words and words[0].partition("=")[0] not in _OPTIONS:
        field = words.pop(0)
    change = parse_change(words, instant)
    if change.lasts_s > 0.0:
        raise BadInputError("lasts: allowed in flights; here: @START..END")
    return InterposedFault(site.name, field, change.operation, change.when, site.side, seed)
