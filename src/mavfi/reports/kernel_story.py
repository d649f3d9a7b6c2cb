"""What a fault did to an instruction and to its kernel, in sentences."""

from collections.abc import Mapping
from typing import Any

from mavfi.reports.change import change

_MEANINGS = {
    "masked": "masked: its output and memory are bit for bit the golden ones",
    "sdc": "silent corruption",
    "crash": "crashed",
    "hang": "hung",
    "exception": "raised an exception",
    "not_reached": "the instruction was not reached",
}


def kernel_story(injection: Mapping[str, Any], outcome: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    """Heading and sentence by turns; nothing for faults that are not in instructions.

    Args:
        injection: Record of the strike.
        outcome: `kernel_outcome` of the flight.
    """
    if outcome is None:
        return []
    story = []
    if injection.get("file"):
        inlined = f", inlined at {', '.join(injection['inlined'])}" if injection["inlined"] else ""
        variable = f" of {injection['variable']}" if injection["variable"] else ""
        story.append((
            "source line",
            f"{injection['file']}:{injection['line']}{inlined}: {injection['opcode']} {injection['type']}{variable} "
            f"({injection['value_class'].replace('_', ' ')}), call {injection['call']}, instruction "
            f"{injection['index']}",
        ))  # fmt: skip
    return [*story, ("kernel", _output(injection["kernel"], outcome))]


def _output(kernel: str, outcome: Mapping[str, Any]) -> str:
    how, first = outcome["outcome"], outcome["first_difference"]
    told = f"{kernel}: {_MEANINGS[how]}"
    if outcome["detail"]:
        told += f" ({outcome['detail']}); the node was started again"
    if how != "sdc":
        return told
    if first is None:
        return f"{told} of what it remembers; nothing that it published differs"
    before, after = change(first["before"], first["after"])
    element = "" if first["element"] is None else f"[{first['element']}]"
    return f"{told}, first in {first['state']}{element}.{first['field']}: golden {before}, here {after}"
