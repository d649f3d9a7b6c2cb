import json

import pytest

from mavfi.errors import BadInputError
from mavfi.hardening.plan import load_plan
from tools.build_certificate import NAME, PLAN, block, read
from tools.markers import GENERATED, ROOT


@pytest.mark.parametrize("page", [ROOT / "README.md", GENERATED / "hardening.md"])
def test_pages_say_what_the_shipped_certificate_says(page):
    sentence, table = block()
    written = page.read_text().partition(f"<!-- {NAME}:begin -->")[2].partition(f"<!-- {NAME}:end -->")[0].strip()
    assert written in (sentence, f"{sentence}\n\n{table}")


def test_a_certificate_of_another_plan_is_refused():
    found = json.loads(PLAN.with_suffix(".certificate.json").read_text())
    assert len(read(load_plan(PLAN), found)) == len(found["functions"])
    with pytest.raises(BadInputError, match="certificate: of plan "):
        read(load_plan(PLAN), {**found, "plan": "0" * 64})
