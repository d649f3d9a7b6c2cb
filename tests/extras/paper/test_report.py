"""Findings of a study in sentences, from tables made by hand."""

from mavfi.analysis.table import Table
from mavfi.extras.paper.report import SectionReport, StudyReport
from mavfi.extras.paper.study import Study, StudySection
from tests.core.unit.analysis.handmade import golden, runs


def test_findings_name_the_claims_that_are_contradicted_below_the_title_of_their_section():
    verdicts = ["confirmed", "contradicted", "undecided", "confirmed"]
    rows = [(f"claim {number}", verdict) for number, verdict in enumerate(verdicts)]
    table = Table.of_text("claims", ["statement", "verdict"], rows, ())
    study = Study(name="small", campaigns={".": "table1"})
    report = StudyReport(study, {}, (SectionReport(StudySection(title="Tested"), None, (table,)),), ())
    assert report.findings == {
        "Tested": ["4 claims: 2 confirmed, 1 contradicted, 1 undecided.", "Contradicted: claim 1."]
    }


def test_no_section_no_findings():
    assert StudyReport(Study(name="small", campaigns={".": "table1"}), {}, (), ()).findings == {}


def test_provenance_names_machines_times_versions_and_whole_digests():
    flown = runs(golden(1), digest="d" * 64, versions={"numba": "2", "mavfi": "1"})
    begun = [{"begun": f"2026-11-2{day} 10:00:00+00:00", "machine": "a CPU", "program": str(day)} for day in (1, 2)]
    study = Study(name="small", campaigns={".": "handmade"})
    report = StudyReport(study, {".": flown}, (), begun)
    assert report.provenance == [
        "Machine: a CPU.",
        "Begun 2026-11-21 10:00:00+00:00, last resumed 2026-11-22 10:00:00+00:00 (run 2).",
        "Program: 1; then 2.",
        "Versions: mavfi 1, numba 2.",
    ]
    assert report.digests == [f"Digest of the ledger in . (handmade): {'d' * 64}."]
    assert report.to_json()["programs"] == ["1", "2"]
