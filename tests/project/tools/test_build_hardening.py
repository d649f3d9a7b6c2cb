"""The page's sentences on hardening, what is certified, and how much is injected for it."""

import json

import pytest

from mavfi.errors import BadInputError
from mavfi.extras.hardening.certify import certification_json
from mavfi.extras.hardening.report import certificate_table
from tools import results
from tools.build_hardening import CERTIFICATE, certificate, certificate_sentence
from tools.stored_certificate import certification_of

PAGE = results.RESULTS / "hardening.md"


def test_the_page_says_what_the_shipped_certificate_says():
    page = PAGE.read_text(encoding="utf-8")
    assert certificate_sentence(certificate(), page) in page
    table = results.TABLES / "hardening" / "certificate.csv"
    assert table.read_text(encoding="utf-8") == certificate_table(certificate()).to_csv()


def test_the_shipped_certificate_is_read_as_it_was_written():
    found = json.loads(CERTIFICATE.read_text(encoding="utf-8"))
    again = certification_json(certification_of(found))
    assert {key: again[key] for key in found} == found


def test_a_certificate_of_another_plan_is_refused(tmp_path):
    other = tmp_path / "other.certificate.json"
    other.write_text(json.dumps({**json.loads(CERTIFICATE.read_text(encoding="utf-8")), "plan": "0" * 64}))
    with pytest.raises(BadInputError, match=r"^other\.certificate\.json: of plan 000000000000"):
        certificate(other)
