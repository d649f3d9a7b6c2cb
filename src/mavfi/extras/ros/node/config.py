"""Configuration of a foreign ROS node under test: command, inputs, and the outputs that are compared."""

import hashlib
import json
from typing import Any

from pydantic import Field

from mavfi.config import Config


class NodeInputs(Config):
    """Inputs sent to a foreign node in every cycle."""

    topic: str
    type: str = Field(description="a standard type, e.g. sensor_msgs/JointState")
    messages: tuple[dict[str, Any], ...] = Field(min_length=1, description="a header is stamped with the time of now")


class NodeOutputs(Config):
    """Outputs of the node: one message per input."""

    topic: str
    ignore: tuple[str, ...] = Field(("seq", "stamp"), description="members that do not count, wherever they stand")


class NodeConfig(Config):
    """A foreign ROS node under test (host `node`); takes the place of a `Scenario` at that host."""

    name: str = Field(description="its name in the graph")
    command: tuple[str, ...] = Field(min_length=1, description="starts it")
    parameters: dict[str, Any] = Field(default_factory=dict, description="of the parameter server, set before")
    inputs: NodeInputs
    outputs: NodeOutputs
    golden_runs: int = Field(3, ge=1, le=1000, description="error-free trials of a mission; their outputs must agree")
    cycles: int = Field(3, ge=1, le=100_000, description="how often all inputs are sent after the injection")
    patience_s: float = Field(2.0, gt=0, le=60, description="without output for so long, the node hangs")

    def to_json(self) -> dict[str, Any]:
        """The configuration as plain data."""
        return self.model_dump(mode="json")

    def key(self) -> str:
        """Identifying hash."""
        return hashlib.sha256(json.dumps(self.to_json(), sort_keys=True).encode()).hexdigest()
