"""Sets of values that are worth duplicating at a price per added instruction, by minimum cuts.

Duplicated alone, a value costs copies and comparisons; with its operands and users, little.  So whole slices must be
chosen at once: the set that maximises benefit - price x cost is the source side of a minimum cut (project selection,
Picard 1976), in which a comparison is one hyperedge: it is paid once if any use lies outside.
"""

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from mavfi.extras.hardening.flow import OUTSIDE, Value, least_executed

_SOURCE, _SINK, _FIRST = 0, 1, 2
_SCALE = 2**29
"""SciPy's capacities are 32-bit integers; more than the sum of all finite ones is infinite."""


class Cuts:
    """Minimum cuts of a kernel for a given benefit.

    The copy of an operand, needed if no operand is chosen, is charged in equal parts to the operands that are not: a
    condition on several operands is not representable in a cut.

    Args:
        values: See `flow.values_of`.
        benefit: Of choosing each value, not negative. Shape (values,).
    """

    def __init__(self, values: Sequence[Value], benefit: np.ndarray) -> None:
        self._n = len(values)
        self._nodes = _FIRST + self._n
        self._edges: list[tuple[int, int, float]] = []  # from, to, cost
        self._tied: list[tuple[int, int]] = []
        self._benefit = np.asarray(benefit, np.float64)
        for index, value in enumerate(values):
            self._add(_FIRST + index, value)

    def _add(self, node: int, value: Value) -> None:
        pay = value.weight * value.executions
        if value.in_loop_header:
            for entry in value.entries:
                if not entry.closes_loop:
                    pay += self._pay(node, entry.value, entry.executions)
        elif not value.own_memory:
            copy = min((entry.executions for entry in value.entries), default=value.executions)
            for operand in value.operands or (OUTSIDE,):
                pay += self._pay(node, operand, copy / max(len(value.operands), 1))
        exits = {use.block: use.executions for use in value.uses}
        if exits:
            pay += self._compare(node, value, value.comparison * least_executed(value, exits.values()))
        self._edges.append((node, _SINK, pay))

    def _pay(self, node: int, other: int, price: float) -> float:
        """Charge a price if a node is chosen and another value is not; returns what is due in any case."""
        if other == OUTSIDE:
            return price
        self._edges.append((node, _FIRST + other, price))
        return 0.0

    def _compare(self, node: int, value: Value, price: float) -> float:
        if any(use.compared or use.user == OUTSIDE for use in value.uses):
            return price
        anywhere = self._nodes
        self._nodes += 1
        self._edges.append((node, anywhere, price))
        self._tied += [(anywhere, _FIRST + use.user) for use in value.uses]
        return 0.0

    def at(self, price: float) -> frozenset[int]:
        """The set that maximises benefit - price x cost, by index of value."""
        wanted = np.flatnonzero(self._benefit > 0)
        if not len(wanted):
            return frozenset()
        start, end, costs = (np.array(part) for part in zip(*self._edges, strict=True))
        tied = np.array(self._tied, np.int64).reshape(-1, 2)
        finite = np.concatenate([self._benefit[wanted], price * costs])
        scaled = np.rint(finite * (_SCALE / max(self._benefit.sum(), 1e-300))).clip(max=_SCALE)
        starts = np.concatenate([np.full(len(wanted), _SOURCE), start, tied[:, 0]])
        ends = np.concatenate([_FIRST + wanted, end, tied[:, 1]])
        weights = np.concatenate([scaled, np.full(len(tied), _SCALE)]).astype(np.int32)
        graph = csr_array((weights, (starts, ends)), shape=(self._nodes, self._nodes))
        graph.sum_duplicates()
        graph.data = graph.data.clip(max=_SCALE).astype(np.int32)
        residual = graph - maximum_flow(graph, _SOURCE, _SINK).flow
        residual.data = np.maximum(residual.data, 0)
        residual.eliminate_zeros()
        reached = breadth_first_order(residual, _SOURCE, return_predecessors=False)
        own = reached[(reached >= _FIRST) & (reached < _FIRST + self._n)]
        return frozenset((own - _FIRST).tolist())
