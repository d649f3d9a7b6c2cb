"""What a campaign on a ROS node is: the YAML files of configs/campaigns with `kind: ros_node`."""

import hashlib
import json
from typing import Any, Literal

from pydantic import Field, model_validator

from mavfi.campaign.scales import at_scale
from mavfi.config import Config
from mavfi.faults.fault import ACCESSES, LONGEST_WALK

KIND = "ros_node"


class Inputs(Config):
    """What the node is sent, over and over."""

    topic: str
    type: str = Field(description="a standard type, e.g. sensor_msgs/JointState")
    messages: tuple[dict[str, Any], ...] = Field(min_length=1, description="a header is stamped with the time of now")


class Outputs(Config):
    """What the node answers: one message to each input."""

    topic: str
    ignore: tuple[str, ...] = Field(("seq", "stamp"), description="members that do not count, wherever they stand")


class NodeScale(Config):
    """How many trials."""

    trials: int = Field(ge=1)


class NodeCampaign(Config):
    """A campaign on a ROS node as a user writes it.

    `trials` strikes for each kind of register.  Where `symbol` is given the node is stopped at its next call; from
    there up to `walk` instructions are executed before the strike.
    """

    kind: Literal["ros_node"]
    name: str
    node: str = Field(description="its name in the graph")
    command: tuple[str, ...] = Field(min_length=1, description="starts it")
    parameters: dict[str, Any] = Field(default_factory=dict, description="of the parameter server, set before")
    inputs: Inputs
    outputs: Outputs
    symbol: str = Field("", description="a function, by its name or a part that no other has")
    registers: tuple[Literal["general", "fp", "all"], ...] = Field(("general", "fp"), min_length=1)
    access: str = "either"
    walk: int = Field(64, ge=1, le=LONGEST_WALK)
    first_seed: int = Field(10_000, ge=0)
    trials: int = Field(40, ge=1, description="for each kind of register")
    golden_runs: int = Field(3, ge=1)
    null_runs: int = Field(3, ge=0, description="everything but the flip")
    cycles: int = Field(3, ge=1, description="how often all inputs are sent after the strike")
    patience_s: float = Field(2.0, gt=0, le=60, description="without output for so long, the node hangs")
    scales: dict[str, NodeScale] = Field(default_factory=dict, description="other sizes, by name")

    @model_validator(mode="after")
    def _consistent(self) -> "NodeCampaign":
        if self.access not in ACCESSES:
            raise ValueError(f"access: {self.access!r}: not known; allowed: {', '.join(ACCESSES)}")
        if len(set(self.registers)) != len(self.registers):
            raise ValueError(f"registers: {', '.join(self.registers)}: allowed: each kind once")
        return self

    def at_scale(self, name: str) -> "NodeCampaign":
        """The campaign at another size; see `mavfi.campaign.scales`."""
        return at_scale(self, self.name, self.scales, name)

    @property
    def count(self) -> int:
        """How many trials it has in all."""
        return self.golden_runs + self.trials * len(self.registers) + self.null_runs

    def key(self) -> str:
        """Hash that identifies the campaign."""
        return hashlib.sha256(json.dumps(self.model_dump(mode="json"), sort_keys=True).encode()).hexdigest()
