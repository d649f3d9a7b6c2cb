"""Who asks which kind of experiment this is: samplers, hosts and views, and few others, each with its reason."""

import ast
from itertools import chain
from types import NoneType

import pytest

from mavfi.faults.fault import find_level, level_names
from mavfi.flight.host import GROUP
from mavfi.plugins import extensions
from tests.core.architecture.source import dotted, modules

HOMES = ("levels/", "flight/", "analysis/", "extras/", "testing.py")
"""Levels draw faults and describe them, hosts inject them, views show them, contract suites ask all of it."""
OWN = {level.sampling.__name__ for host in extensions(GROUP).values() for level in host.samplings.values()}
"""Classes of draws that hosts have in the place of those of a level."""
KINDS = OWN | {f"{level.capitalize()}{what}" for level in level_names() for what in ("Fault", "Request", "Sampling")}
"""Classes of a fault, of the request for one, and of a campaign's draws."""
ASKED = {"level", "scheme", "host", "kernels"}
"""Attributes and names which say what kind of experiment this is."""
ALLOWED = {
    "campaign/config.py": 4,  # a host may bring keys and rules of its own
    "cli/fly.py": 1,  # options before the slow imports: flights that fork
}
"""Questions elsewhere, by module; fewer is fine, lower the number then."""


def names_a_level(node: ast.AST) -> bool:
    """Whether this is the level with which the text of a fault begins, as in "state:planning.waypoint.x"."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value.partition(":")[0] in level_names()
    return isinstance(node, ast.Attribute) and node.attr == "level"


def asks(node: ast.AST) -> bool:
    """Whether an expression asks for the level of a fault, the scheme of its draw or the kind of host."""
    if isinstance(node, ast.Call) and dotted(node.func) == "isinstance":
        return any(dotted(part).rpartition(".")[2] in KINDS for part in ast.walk(node.args[1]))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "startswith":
        return any(map(names_a_level, chain.from_iterable(map(ast.walk, node.args))))
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
    [
        "fault.level == 'state'",
        "kernels is None",
        "isinstance(fault, StateFault)",
        "'node' != campaign.host",
        "sampling.scheme == 'groups'",
        "one.level == RegisterFault.level",
        "isinstance(x, str | InstructionRequest)",
        "isinstance(campaign.sampling, InstructionSampling)",
        "isinstance(one, config.SensorSampling)",
        "fault.startswith('instruction')",
        "(fault or '').startswith(('instruction:', 'memory:'))",
        "text.startswith(f'{SensorFault.level}:')",
        "fault.startswith('state:planning.waypoint')",
    ],
)
def test_a_question_is_recognised(code):
    assert any(map(asks, ast.walk(ast.parse(code))))


def test_every_class_of_a_fault_and_of_a_draw_is_known():
    classes = {node.name for tree in modules().values() for node in ast.walk(tree) if isinstance(node, ast.ClassDef)}
    draws = {name for name in classes if name.endswith("Sampling")} - {"Sampling"}
    assert draws == OWN | {f"{level.capitalize()}Sampling" for level in level_names()}
    assert {kind.__name__ for kind in (find_level(name).fault for name in level_names())} | draws <= KINDS


def test_only_samplers_hosts_and_views_ask_what_kind_of_experiment_this_is():
    questions = {
        name: number
        for name, tree in modules().items()
        if not name.startswith(HOMES) and (number := sum(map(asks, ast.walk(tree))))
    }
    assert questions == ALLOWED
