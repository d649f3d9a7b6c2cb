"""Loops of a function."""

from mavfi.ir.flow import back_edges, loop_depths, successors
from mavfi.ir.module import BasicBlock, Function, Instruction


def function(**edges):
    """A function whose blocks jump to the given labels."""
    blocks = []
    for name, targets in edges.items():
        tokens = ["br"] if targets else ["ret"]
        for target in targets:
            tokens += ["label", f"%{target}"]
        blocks.append(BasicBlock(f"%{name}", terminator=Instruction(tokens[0], tokens)))
    return Function("@f", "", "i32", [], blocks)


def test_edges_that_close_loops():
    nested = function(start=["a"], a=["b", "d"], b=["b", "c"], c=["a"], d=[])
    assert successors(nested.blocks[1].terminator) == ["%b", "%d"]
    assert back_edges(nested) == {("%b", "%b"), ("%c", "%a")}
    assert loop_depths(nested) == {"%start": 0, "%a": 1, "%b": 2, "%c": 1, "%d": 0}
