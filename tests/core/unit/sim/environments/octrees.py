"""A writer of OctoMap's files, apart from the reader of the package."""

import struct


def tree_of(voxels, depth=16, corner=(0, 0, 0)):
    """Nested octree of {(i, j, k): occupied}: a leaf is a bool, an inner node a list of eight, unknown None.

    Eight equal leaves are pruned to one, as OctoMap does.
    """
    if not voxels:
        return None
    if depth == 0:
        return next(iter(voxels.values()))
    half = 1 << (depth - 1)
    children = []
    for child in range(8):
        low = tuple(corner[a] + half * (child >> a & 1) for a in range(3))
        inside = {k: v for k, v in voxels.items() if all(low[a] <= k[a] < low[a] + half for a in range(3))}
        children.append(tree_of(inside, depth - 1, low))
    if children in ([True] * 8, [False] * 8):
        return children[0]
    return children


def bits(node):
    """Body of a `.bt` file, depth first."""
    code = {None: 0, False: 1, True: 2}
    word = sum((3 if isinstance(c, list) else code[c]) << 2 * i for i, c in enumerate(node))
    return struct.pack("<H", word) + b"".join(bits(c) for c in node if isinstance(c, list))


def values(node, more=b""):
    """Body of an `.ot` file, depth first, whose nodes have `more` data after their log-odds."""
    if not isinstance(node, list):
        return struct.pack("<f", 1.5 if node else -0.7) + more + b"\0"
    mask = sum(1 << i for i, c in enumerate(node) if c is not None)
    inside = b"".join(values(c, more) for c in node if c is not None)
    return struct.pack("<f", 0.4) + more + bytes([mask]) + inside


def count(node):
    """Number of nodes."""
    if not isinstance(node, list):
        return 1
    return 1 + sum(count(child) for child in node if child is not None)
