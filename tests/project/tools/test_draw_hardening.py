"""The picture of the kernels' curves reads the table that `make results NAME=hardening` writes."""

import csv
from collections import Counter

import numpy as np

from tools.draw_hardening import curves
from tools.results import TABLES


def test_each_function_of_the_table_has_its_steps():
    with (TABLES / "hardening" / "curves.csv").open(encoding="utf-8", newline="") as file:
        rows = Counter(f"{row['function']} ({row['kernel']})" for row in csv.DictReader(file))
    found = curves()
    assert len(found) >= 5
    for name, steps in found.items():
        assert len(steps) == rows[name]
        times = np.array([step.time for step in steps])
        rates = np.array([step.predicted[0] for step in steps if not np.isnan(step.predicted[0])])
        assert (times > 0.9).all() and ((rates >= 0.0) & (rates <= 100.0)).all()
