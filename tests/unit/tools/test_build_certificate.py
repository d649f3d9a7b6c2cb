import json

import pytest

from mavfi.campaign.hardening.certification import certification_json, certification_of
from tools import build_certificate
from tools.build_certificate import CERTIFICATE, NAME, blocks, main
from tools.build_hardening import PAGE
from tools.markers import ROOT


@pytest.mark.parametrize(("page", "place"), [(ROOT / "README.md", 0), (PAGE, 1)])
def test_pages_say_what_the_shipped_certificate_says(page, place):
    written = page.read_text().partition(f"<!-- {NAME}:begin -->")[2].partition(f"<!-- {NAME}:end -->")[0]
    assert written.strip() == blocks()[place]


def test_the_shipped_certificate_is_read_as_it_was_written():
    found = json.loads(CERTIFICATE.read_text())
    again = certification_json(certification_of(found))
    assert {key: again[key] for key in found} == found


def test_a_certificate_of_another_plan_is_refused(monkeypatch, tmp_path, capsys):
    other = tmp_path / "other.certificate.json"
    other.write_text(json.dumps({**json.loads(CERTIFICATE.read_text()), "plan": "0" * 64}))
    monkeypatch.setattr(build_certificate, "CERTIFICATE", other)
    assert main() == 2 and capsys.readouterr().err.startswith("bad input: other.certificate.json: of plan 000000000000")
