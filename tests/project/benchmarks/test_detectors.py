"""The table of costs: its rows, what is left out and why, and which detectors fly again."""

from benchmarks.detectors import DETECTORS, table
from mavfi.extras.bench.bench import load_bench
from mavfi.extras.paper.overheads import STAGES, Cost

SPENT = dict.fromkeys(STAGES, 0.002)


def cost(seconds, kernels=0.1, shown=100):
    return Cost(kernels, {**SPENT, "all": seconds}, SPENT, shown, 0.005, 1.0)


def test_a_row_has_medians_and_extremes_of_flights():
    key = ("published", "duplicate", "paper")
    lines = table({key: [cost(0.01), cost(0.03), cost(0.02)]}, 4, 3, {}).splitlines()
    assert lines[-1] == ("| `duplicate`, `paper` | `published` | 200.00 | 20.00 (10.00 – 30.00) | – | 2.00 | 0.50 |")
    assert "the kernels take 100 ms (`published`) of a flight" in lines[0]


def test_every_scheme_of_the_bench_that_is_no_bound_is_measured():
    names = {arm.detector for arm in load_bench("mavfi-bench-1").arms.values() if arm.detector}
    assert {name for name, _, _ in DETECTORS} == names - {"random", "oracle"}
