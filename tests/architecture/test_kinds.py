"""Who asks which kind of experiment this is: samplers, hosts and views, and few others, each with its reason."""

import ast
from types import NoneType

import pytest

from tests.architecture.source import dotted, modules

HOMES = ("campaign/samplers/", "hosts/", "campaign/analysis/")
"""Samplers draw faults of a level, hosts inject them, views show them."""
KINDS = {
    "StateFault", "MemoryFault", "InstructionFault", "RegisterFault", "MessageFault", "StateRequest", "MemoryRequest",
    "InstructionRequest", "SensorFault", "SensorRequest",
}  # fmt: skip
ASKED = {"level", "scheme", "host", "kernels"}
"""Attributes and names which say what kind of experiment this is."""
ALLOWED = {
    "bridges/airsim/boundary.py": 2,  # a host of its own: faults in calls, and in the vehicle behind them
    "campaign/config.py": 1,  # keys that go together: groups with their scheme
    "faults/register/tracer.py": 1,  # an order to this process is of its level
}
"""Questions elsewhere, by module; fewer is fine, lower the number then."""


def asks(node: ast.AST) -> bool:
    """Whether an expression asks for the level of a fault, the scheme of its draw or the kind of host."""
    if isinstance(node, ast.Call) and dotted(node.func) == "isinstance":
        return any(isinstance(part, ast.Name) and part.id in KINDS for part in ast.walk(node.args[1]))
    if isinstance(node, ast.MatchClass):
        return dotted(node.cls) in KINDS
    if not isinstance(node, ast.Compare):
        return False
    sides = [node.left, *node.comparators]
    against = [isinstance(side, ast.Constant) and isinstance(side.value, str | NoneType) for side in sides]
    named = [dotted(side).rpartition(".")[2] in ASKED for side in sides]
    return (any(against) and any(named)) or sum(named) > 1


@pytest.mark.parametrize(
    "code",
    ["fault.level == 'state'", "kernels is None", "isinstance(fault, StateFault)", "'node' != campaign.host",
     "sampling.scheme == 'groups'", "one.level == RegisterFault.level", "isinstance(x, str | InstructionRequest)"],
)  # fmt: skip
def test_a_question_is_recognised(code):
    assert any(map(asks, ast.walk(ast.parse(code))))


@pytest.mark.parametrize("code", ["level > limit", "fault.bit == 3", "isinstance(fault, str)", "site is None"])
def test_other_questions_are_none(code):
    assert not any(map(asks, ast.walk(ast.parse(code))))


def test_only_samplers_hosts_and_views_ask_what_kind_of_experiment_this_is():
    found = {
        name: number
        for name, tree in modules().items()
        if not name.startswith(HOMES) and (number := sum(map(asks, ast.walk(tree))))
    }
    assert found == ALLOWED
