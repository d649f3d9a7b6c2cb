"""The search for the tracker's gains: seeds, variants, verdicts."""

import pytest

from benchmarks.tune_pid import check_seeds
from mavfi.errors import BadInputError


@pytest.mark.parametrize(("first", "count"), [(10_000, 1), (9_999, 2), (-1, 1), (5, 0)])
def test_seeds_that_are_for_results_are_refused(first, count):
    with pytest.raises(BadInputError, match=f"SEED={first} N={count}: allowed: seeds from 0 to 9999"):
        check_seeds(first, count)
