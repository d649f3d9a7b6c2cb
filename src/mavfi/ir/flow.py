"""Control flow of a function: successors of blocks, and loops."""

from mavfi.ir.module import Function, Instruction


def successors(terminator: Instruction | None) -> list[str]:
    """Labels to which a terminator can jump; empty for other instructions."""
    tokens = [] if terminator is None else terminator.tokens
    return [after for token, after in zip(tokens, tokens[1:], strict=False) if token == "label"]


def back_edges(function: Function) -> set[tuple[str, str]]:
    """Edges (from, to) that close a loop: their target is on the path of a depth-first search."""
    following = {block.label: successors(block.terminator) for block in function.blocks}
    found: set[tuple[str, str]] = set()
    entry = function.blocks[0].label
    path = {entry}
    done = {entry}
    stack = [(entry, iter(following[entry]))]
    while stack:
        here, rest = stack[-1]
        label = next(rest, None)
        if label is None:
            path.discard(here)
            stack.pop()
        elif label in path:
            found.add((here, label))
        elif label not in done:
            path.add(label)
            done.add(label)
            stack.append((label, iter(following[label])))
    return found


def loop_depths(function: Function) -> dict[str, int]:
    """Number of loops around each block, by label."""
    before: dict[str, list[str]] = {block.label: [] for block in function.blocks}
    for block in function.blocks:
        for label in successors(block.terminator):
            before[label].append(block.label)
    bodies: dict[str, set[str]] = {}
    for latch, header in back_edges(function):
        body = bodies.setdefault(header, {header})
        waiting = [latch]
        while waiting:
            label = waiting.pop()
            if label not in body:
                body.add(label)
                waiting += before[label]
    return {label: sum(label in body for body in bodies.values()) for label in before}
