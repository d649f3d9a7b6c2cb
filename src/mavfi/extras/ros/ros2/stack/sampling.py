"""Faults in a stack's messages, drawn from those of an error-free run: `faults` for each topic.

An operation is drawn, then a message of the topic, then a number in it, then a bit.  All are uniform; messages without
a number that the operation can change are left out.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from mavfi.errors import BadInputError
from mavfi.extras.registers.level import RegisterLevel
from mavfi.extras.ros.ros2.stack.config import StackConfig
from mavfi.faults.changes import Change, When
from mavfi.faults.fault import Fault
from mavfi.faults.operations import MESSAGE_OPERATIONS, Operation, check_number_operation
from mavfi.faults.sampling import stream
from mavfi.levels.campaign import SampledCampaign
from mavfi.levels.level import (
    Draw,
    Golden,
    Sampler,
    Sampling,
    check_distinct,
    check_known,
    operation_of,
)
from mavfi.levels.message import MessageLevel
from mavfi.levels.message.fault import MessageFault

INPUT_OPERATIONS = ("drop", "freeze")
"""What can be done to whole messages where they are received, as inputs are."""
_NEVER = 1 << 40
"""Number of a message that never comes."""


class MessageNumbers(NamedTuple):
    """Numbers that have a path in common: one, or those of an array.

    Attributes:
        path: Path of the field, e.g. "pose.position.x", "position".
        dtype: NumPy's name of the type.
        length: Length of the array; -1 = a single number.
    """

    path: str
    dtype: str
    length: int

    @property
    def size(self) -> int:
        """How many numbers."""
        return abs(self.length)

    def site(self, index: int) -> str:
        """Path of one of the numbers."""
        if self.length < 0:
            return self.path
        return f"{self.path}[{index}]"


class TopicMessages(NamedTuple):
    """The messages of a topic in an error-free run: the numbers in each."""

    topic: str
    messages: tuple[tuple[MessageNumbers, ...], ...]


class StackSampling(Sampling):
    """Faults in the messages of a ROS 2 stack (host ros2_stack)."""

    level: Literal["message"]
    topics: tuple[str, ...] = Field(
        (), description="`faults` for each; by default all inputs, outputs and watched ones"
    )
    operations: tuple[str, ...] = Field(
        ("flip",), min_length=1, description="each with the same probability, e.g. flip, set=nan, drop, delay=0.2"
    )

    @model_validator(mode="after")
    def _consistent(self) -> "StackSampling":
        check_distinct("sampling.topics", self.topics)
        check_distinct("sampling.operations", self.operations)
        for text in self.operations:
            try:
                operation_of(text)
            except BadInputError as error:
                raise ValueError(f"sampling.operations: {text!r}: {error}") from None
        return self


class StackSampler(Sampler):
    """Draws an operation, a message, a number and a bit.

    Raises:
        BadInputError: A topic is not one of the stack, or none of the operations is possible in it.
    """

    alternates = True
    draws_together = False

    def __init__(self, campaign: SampledCampaign) -> None:
        super().__init__(campaign)
        stack: StackConfig = campaign.under_test
        topics = self.sampling.topics or stack.topics
        try:
            check_known("sampling.topics", topics, stack.topics)
        except ValueError as error:
            raise BadInputError(str(error)) from None
        self._changes: dict[str, list[Change]] = {}
        for topic in topics:
            changes = [operation_of(text) for text in self.sampling.operations]
            if topic in stack.input_topics:
                changes = [change for change in changes if _is_possible_in_input(change.operation)]
            if not changes:
                raise BadInputError(
                    f"sampling.operations: {', '.join(self.sampling.operations)}: not possible in the input {topic}; "
                    f"allowed: {', '.join(INPUT_OPERATIONS)}, and those of a number"
                )
            self._changes[topic] = changes
        self.targets = dict.fromkeys(topics, {"": 1.0})

    def draw(self, draws: Sequence[Draw], environment: str, golden: Golden) -> list[Fault | None]:
        """One fault per draw; None without a golden run, or if it has no message that can be changed."""
        return [self._fault(requested, environment, golden) for requested in draws]

    def null(self, index: int, seed: int, environment: str, golden: Golden) -> Fault:
        """A fault that multiplies a number by 1; topics alternate."""
        topics = list(self.targets)
        topic = topics[index % len(topics)]
        random = stream(seed, "null message", topic, environment, index)
        unchanged = Change(Operation("scale", 1.0), When())
        fault = _number_fault(topic, unchanged, _messages(golden, topic), random, seed)
        if fault is None:
            return MessageFault(topic, seed=seed, change=Change(Operation("drop"), When(first=_NEVER)))
        return fault

    def _fault(self, requested: Draw, environment: str, golden: Golden) -> MessageFault | None:
        """The fault of a draw; those of one mission differ by how often it was used before."""
        topic = requested.target
        messages = _messages(golden, topic)
        if not messages:
            return None
        number_of_use = self.repetition(requested.index)
        random = stream(requested.seed, "message", topic, environment, number_of_use)
        # What no message of the topic can undergo, such as a flip without any number, is not drawn.
        changes = [change for change in self._changes[topic] if _is_possible(change, messages)]
        if not changes:
            return None
        change = changes[int(random.integers(len(changes)))]
        seed = int(random.integers(2**31))
        if change.operation.name not in MESSAGE_OPERATIONS or change.operation.name == "freeze":
            fault = _number_fault(topic, change, messages, random, seed)
            if fault is not None or change.operation.name != "freeze":
                return fault
        return MessageFault(topic, seed=seed, change=_at(change, int(random.integers(len(messages)))))


def _is_possible_in_input(operation: Operation) -> bool:
    """Whether an operation is possible where a message is received."""
    return operation.name not in MESSAGE_OPERATIONS or operation.name in INPUT_OPERATIONS


def _is_possible(change: Change, messages: Sequence[Sequence[MessageNumbers]]) -> bool:
    """Whether an operation can be applied to one of the messages."""
    if change.operation.name in MESSAGE_OPERATIONS:
        return True
    return any(next(_changeable(numbers, change.operation), None) is not None for numbers in messages)


def _messages(golden: Golden, topic: str) -> tuple[tuple[MessageNumbers, ...], ...]:
    """The messages of a topic in the golden run of the campaign's own mission."""
    if "" not in golden:
        return ()
    recorded: Sequence[TopicMessages] = getattr(golden[""].flight, "calls", ())
    for entry in recorded:
        if entry.topic == topic:
            return entry.messages
    return ()


def _number_fault(
    topic: str,
    change: Change,
    messages: Sequence[Sequence[MessageNumbers]],
    random: np.random.Generator,
    seed: int,
) -> MessageFault | None:
    """A fault in a number of one of the messages; None if none of them has a number that the operation can change."""
    possible = [list(_changeable(numbers, change.operation)) for numbers in messages]
    indices = [index for index, numbers in enumerate(possible) if numbers]
    if not indices:
        return None
    index = indices[int(random.integers(len(indices)))]
    fields = possible[index]
    drawn = int(random.integers(sum(numbers.size for numbers in fields)))
    for numbers in fields:
        if drawn < numbers.size:
            break
        drawn -= numbers.size
    if change.operation.name == "flip" and change.operation.bit is None:
        bit = int(random.integers(_width(numbers.dtype)))
        change = change._replace(operation=replace(change.operation, bit=bit))
    return MessageFault(topic, numbers.site(drawn), seed=seed, change=_at(change, index))


def _changeable(numbers: Sequence[MessageNumbers], operation: Operation) -> Iterator[MessageNumbers]:
    """The numbers whose type allows an operation."""
    for entry in numbers:
        checked_operation = operation
        if operation.name == "flip" and operation.bit is None:
            checked_operation = replace(operation, bit=0)
        try:
            if operation.name != "freeze":
                check_number_operation(checked_operation, entry.dtype)
        except BadInputError:
            continue
        yield entry


def _width(dtype: str) -> int:
    """Number of bits that can be flipped."""
    if dtype == "?":
        return 1
    return 8 * np.dtype(dtype).itemsize


def _at(change: Change, index: int) -> Change:
    """The change from a message on, whose number counts from 0 here."""
    return change._replace(when=replace(change.when, first=index + 1))


class StackMessageLevel(MessageLevel):
    """Faults in the messages of a stack, as the host draws them."""

    sampling = StackSampling
    sampler = StackSampler

    def about(self, campaign: SampledCampaign) -> dict[str, Any]:
        """See `Level.about`: the stack under test."""
        operations = ", ".join(campaign.sampling.operations)
        return _about(campaign, "topic", f"one fault per run, {operations}; uniform over messages and numbers")


class StackRegisterLevel(RegisterLevel):
    """Faults in registers of a stack's processes."""

    def about(self, campaign: SampledCampaign) -> dict[str, Any]:
        """See `Level.about`: the stack under test."""
        sampling = campaign.sampling
        start = "from an input on"
        if sampling.symbol:
            start = f"from the next call of {sampling.symbol!r} on"
        how = f"one bit per run, {start}, after up to {sampling.walk} instructions; processes in turn"
        return _about(campaign, "kind of registers", how)


def _about(campaign: SampledCampaign, each: str, how: str) -> dict[str, Any]:
    """What is under test, and how faults are drawn."""
    commands = "; ".join(" ".join(command) for command in campaign.under_test.commands)
    title = f"campaign {campaign.name} · ROS 2 stack {', '.join(campaign.environments)}"
    return {"each": each, "profile": "", "title": title, "lines": [commands, how]}
