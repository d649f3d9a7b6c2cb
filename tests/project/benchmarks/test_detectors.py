"""The table of costs: its rows, and which detectors it has."""

from benchmarks.detectors import DETECTORS, table
from mavfi.extras.bench.bench import load_bench
from mavfi.extras.paper.overheads import STAGES, Cost

SPENT = dict.fromkeys(STAGES, 0.002)


def cost(seconds, kernels=0.1, shown=100):
    return Cost(kernels, {**SPENT, "all": seconds}, SPENT, shown, 0.005, 1.0)


def test_a_row_has_medians_and_extremes_of_flights():
    costs = {
        ("published", "duplicate", "paper"): [cost(0.01), cost(0.03), cost(0.02)],
        ("hardened", "duplicate", "paper"): [cost(0.04, kernels=0.2)],
        ("published", "gaussian", "tuned"): [cost(0.001)],
        ("hardened", "gaussian", "tuned"): [cost(0.02, kernels=0.2)],
    }
    lines = table(costs, 4, 3).splitlines()
    assert lines[-2:] == [
        "| `gaussian`, `tuned` | 10.00 | 1.00 (1.00–1.00) | 200.00 | 10.00 (10.00–10.00) | 6, not met |",
        "| `duplicate`, `paper` | 200.00 | 20.00 (10.00–30.00) | 400.00 | 20.00 (20.00–20.00) | – |",
    ]
    assert "take 100 and 200 ms of a golden flight" in lines[0]
    assert "takes 1.0 to 2.0 %" in lines[0]
    assert lines[0].endswith("`gaussian`, `tuned` 0.50 and 0.50 %; `duplicate`, `paper` 0.50 and 0.50 %.")


def test_every_scheme_of_the_bench_that_is_no_bound_is_measured():
    names = {arm.detector for arm in load_bench("mavfi-bench-1").arms.values() if arm.detector}
    assert {name for name, _, _ in DETECTORS} == names - {"random", "oracle"}
