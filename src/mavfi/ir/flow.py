"""Control flow of a function: successors of blocks, and loops."""

from mavfi.ir.module import Function, Instruction


def successors(terminator: Instruction | None) -> list[str]:
    """Labels to which a terminator can jump; empty for other instructions."""
    if terminator is None:
        return []
    tokens = terminator.tokens
    return [following for token, following in zip(tokens, tokens[1:], strict=False) if token == "label"]


def back_edges(function: Function) -> set[tuple[str, str]]:
    """Edges (from, to) that close a loop: their target is on the path of a depth-first search."""
    targets = {block.label: successors(block.terminator) for block in function.blocks}
    edges: set[tuple[str, str]] = set()
    entry = function.blocks[0].label
    path = {entry}
    visited = {entry}
    stack = [(entry, iter(targets[entry]))]  # the path, with the targets that are still to be visited
    while stack:
        source, remaining = stack[-1]
        label = next(remaining, None)
        if label is None:
            path.discard(source)
            stack.pop()
        elif label in path:
            edges.add((source, label))
        elif label not in visited:
            path.add(label)
            visited.add(label)
            stack.append((label, iter(targets[label])))
    return edges


def loop_depths(function: Function) -> dict[str, int]:
    """Number of loops around each block, by label."""
    predecessors: dict[str, list[str]] = {block.label: [] for block in function.blocks}
    for block in function.blocks:
        for label in successors(block.terminator):
            predecessors[label].append(block.label)
    # The body of a loop: its header, and all blocks from which the back edge is reached without passing the header.
    bodies: dict[str, set[str]] = {}
    for latch, header in back_edges(function):
        body = bodies.setdefault(header, {header})
        waiting = [latch]
        while waiting:
            label = waiting.pop()
            if label not in body:
                body.add(label)
                waiting += predecessors[label]
    return {label: sum(label in body for body in bodies.values()) for label in predecessors}
