"""Comparison of results and arguments: bits, not values."""

from typing import NamedTuple

import numpy as np
import pytest

from mavfi.hosts.instruction.forking import same_bits


class Tree(NamedTuple):
    nodes: np.ndarray
    count: int


def tree(value=1.0):
    return Tree(np.array([[0.0, value], [2.0, np.nan]]), 2)


QUIET, OTHER = np.array([0x7FF8000000000000, 0x7FF8000000000001], np.uint64).view(np.float64)


@pytest.mark.parametrize(
    ("one", "other", "equal"),
    [
        ((tree(), 1.5), (tree(), 1.5), True),
        ((tree(), 1.5), (tuple(tree()), 1.5), True),
        ((tree(), 1.5), (tree(0.5), 1.5), False),
        (tree(0.0), tree(-0.0), False),
        (np.array([QUIET]), np.array([QUIET]), True),
        (np.array([QUIET]), np.array([OTHER]), False),
        (QUIET, QUIET, True),
        (QUIET, OTHER, False),
        (0.0, -0.0, False),
        (1, 1.0, False),
        (np.zeros(3), np.zeros(4), False),
        (np.zeros(2), np.zeros(2, np.float32), False),
        (np.zeros((4, 4))[::2, 1], np.zeros(2), True),
        (np.zeros(0, [("x", "f8")]), np.zeros(0, [("x", "f8")]), True),
        (None, None, True),
    ],
)
def test_values_are_the_same_if_their_bits_are(one, other, equal):
    assert same_bits(one, other) is equal
