"""Inputs of a stack as the driver takes them."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mavfi.errors import BadInputError, not_installed
from mavfi.extras.ros.ros2.stack.config import StackConfig


def inputs_of(stack: StackConfig) -> tuple[list[dict[str, Any]], bytes]:
    """The inputs as the driver takes them, and the bytes of serialized ones.

    Raises:
        BadInputError: The recording cannot be read.
    """
    inputs = stack.inputs
    if inputs.messages:
        entries = []
        for index, data in enumerate(inputs.messages):
            offset_s = None
            if inputs.period_s is not None:
                offset_s = index * inputs.period_s
            entries.append({"topic": inputs.topic, "kind": inputs.type, "offset_s": offset_s, "data": data})
        return entries, b""
    if not inputs.bag:
        return [], b""
    outputs = {output.topic for output in stack.outputs}
    entries = []
    contents = []
    for topic, kind, time_ns, content in _recorded(Path(inputs.bag)):
        if topic in outputs or (inputs.topics and topic not in inputs.topics):
            continue
        entries.append({"topic": topic, "kind": kind, "offset_s": 1e-9 * time_ns, "size": len(content)})
        contents.append(content)
    if not entries:
        raise BadInputError(f"stack.inputs.bag: {inputs.bag}: holds no message of these topics")
    return entries, b"".join(contents)


def _recorded(path: Path) -> Iterator[tuple[str, str, int, bytes]]:
    """Messages of a recording: topic, type, time since the first (ns), and serialized bytes."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise not_installed(f"stack.inputs.bag: {path}", "rosbags", "logs") from None
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
            first_ns = reader.start_time
            for connection, time_ns, content in reader.messages():
                yield connection.topic, connection.msgtype, time_ns - first_ns, bytes(content)
    except Exception as error:  # noqa: BLE001 - whatever the reader raises for a file that is none
        raise BadInputError(f"stack.inputs.bag: {path}: cannot be read ({error})") from None
