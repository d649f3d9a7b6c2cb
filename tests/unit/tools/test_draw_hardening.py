"""The picture of the kernels' curves reads the page that `make hardening` writes."""

import numpy as np

from tools.draw_hardening import curves
from tools.markers import GENERATED


def test_each_function_of_the_page_has_its_steps():
    found = curves()
    page = (GENERATED / "hardening.md").read_text(encoding="utf-8")
    table = page.split("| function | step |")[1].split("\n\n")[0]
    assert len(found) >= 5
    for name, steps in found.items():
        function = name.partition(" ")[0]
        assert len(steps) == table.count(f"| `{function}` ")
        times = np.array([step.time for step in steps])
        rates = np.array([step.predicted[0] for step in steps if not np.isnan(step.predicted[0])])
        assert (times > 0.9).all() and ((rates >= 0.0) & (rates <= 100.0)).all()
