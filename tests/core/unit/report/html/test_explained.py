import json
import re

import pytest

from mavfi.analysis.listing import ordered, partner
from mavfi.cli import run


@pytest.mark.slow
@pytest.mark.long
def test_the_page_of_a_run_has_the_same_fault_in_another_arm(capsys, flown, runs, tmp_path):
    run_id = next(candidate for candidate in ordered(runs.frame) if "-fi-" in candidate)
    path = tmp_path / "run.html"
    assert run(["explain", str(flown), run_id, "--html", str(path)]) == 0
    capsys.readouterr()
    data = json.loads(re.search(r'id="flight-data">(.*?)</script>', path.read_text(encoding="utf-8"), re.DOTALL)[1])
    assert run_id in data["context"] and data["data"]["lines"]
    assert [command for _, command in data["commands"]][0] == f"mavfi replay {flown} {run_id}"
    expected = ["golden", "injected"] if partner(runs.frame, run_id) is None else ["golden", "injected", "recovered"]
    assert [path["role"] for path in data["data"]["paths"]] == expected
