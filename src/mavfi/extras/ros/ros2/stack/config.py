"""Configuration of a stack under test: its nodes, inputs, outputs, and a verdict."""

import hashlib
import json
from typing import Any

from pydantic import Field, model_validator

from mavfi.config import Config

BAGS = (".mcap", ".db3")
"""File name extensions of recordings that can be played."""


class StackInputs(Config):
    """What the stack gets: messages, a recording, or a program that publishes."""

    topic: str = Field("", description="of the messages")
    type: str = Field("", description="of the messages, e.g. sensor_msgs/msg/JointState")
    messages: tuple[dict[str, Any], ...] = Field((), description="fields that are not zero")
    period_s: float | None = Field(
        None, gt=0, le=60, description="between messages; by default each waits for an output on every topic"
    )
    bag: str = Field("", description="a recording (.mcap, .db3) that is played at its own times")
    topics: tuple[str, ...] = Field((), description="of the recording or the script; all of a recording by default")
    script: tuple[str, ...] = Field((), description="a program that publishes, and ends")

    @model_validator(mode="after")
    def _consistent(self) -> "StackInputs":
        kinds = [bool(self.messages), bool(self.bag), bool(self.script)]
        if sum(kinds) != 1:
            raise ValueError("inputs: allowed: either messages, or bag, or script")
        if self.messages and not (self.topic and self.type):
            raise ValueError("inputs: messages: allowed: with topic and type")
        if self.bag and not self.bag.endswith(BAGS):
            raise ValueError(f"inputs.bag: {self.bag}: allowed endings: {', '.join(BAGS)}")
        if self.script and not self.topics:
            raise ValueError("inputs.script: allowed: with topics, those that it publishes")
        return self


class StackOutput(Config):
    """A topic whose messages are compared with those of the error-free run."""

    topic: str
    fields: tuple[str, ...] = Field((), description="paths; all by default, but members named stamp")
    tolerance: float = Field(0.0, ge=0, description="largest difference of a number that does not count")


class StackConfig(Config):
    """A ROS 2 stack under test (host `ros2_stack`); takes the place of a `Scenario` at that host."""

    distribution: str = Field("", description='e.g. jazzy; "" = the first installation')
    nodes: tuple[tuple[str, ...], ...] = Field((), description="commands, each a list of words")
    launch: tuple[str, ...] = Field((), description="instead: a command that starts them, e.g. [ros2, launch, p, f]")
    inputs: StackInputs
    outputs: tuple[StackOutput, ...] = Field(min_length=1)
    watch: tuple[str, ...] = Field((), description="further topics that faults may be in, and detectors watch")
    verdict: str | tuple[str, ...] = Field(
        "", description="FILE.py:FUNCTION of the recorded outputs, or a command that reads them as JSON from stdin"
    )
    variables: dict[str, str] = Field(default_factory=dict, description="environment variables of the nodes")
    golden_runs: int = Field(3, ge=1, le=1000, description="error-free runs of a mission; their outputs must agree")
    patience_s: float = Field(2.0, gt=0, le=600, description="without an output for so long, the stack hangs")
    start_s: float = Field(20.0, gt=0, le=600, description="time limit for its start")
    fork: bool = Field(True, description="whether scripts are imported once, and forked for each run, if they can be")

    @model_validator(mode="after")
    def _consistent(self) -> "StackConfig":
        if bool(self.nodes) == bool(self.launch):
            raise ValueError("stack: allowed: either nodes, or launch")
        if not all(self.nodes):
            raise ValueError("stack.nodes: an empty command; allowed: a program and its arguments")
        for topic in self.topics:
            if not topic.startswith("/"):
                raise ValueError(f"stack: topic {topic!r}: allowed: full names, e.g. /{topic}")
        topics = [output.topic for output in self.outputs]
        if len(set(topics)) < len(topics):
            raise ValueError(f"stack.outputs: {', '.join(topics)}: allowed: each topic once")
        return self

    @property
    def commands(self) -> tuple[tuple[str, ...], ...]:
        """Commands that start the stack."""
        return self.nodes or (self.launch,)

    @property
    def input_topics(self) -> tuple[str, ...]:
        """Topics that the stack reads; of a recording without `topics` none are known before it is read."""
        if self.inputs.topic:
            return (self.inputs.topic,)
        return self.inputs.topics

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics in which faults can be: inputs, outputs, and those that are watched."""
        names = (*self.input_topics, *(output.topic for output in self.outputs), *self.watch)
        return tuple(dict.fromkeys(names))

    def to_json(self) -> dict[str, Any]:
        """The configuration as plain data."""
        return self.model_dump(mode="json")

    def key(self) -> str:
        """Identifying hash."""
        return hashlib.sha256(json.dumps(self.to_json(), sort_keys=True).encode()).hexdigest()
