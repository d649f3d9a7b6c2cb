"""Findings of a study in sentences, from tables made by hand."""

from mavfi.campaign.analysis.table import Table
from mavfi.campaign.study import Section, Study
from mavfi.reports.study_report import SectionReport, StudyReport


def test_findings_name_the_claims_that_are_contradicted_below_the_title_of_their_section():
    verdicts = ["confirmed", "contradicted", "undecided", "confirmed"]
    rows = [(f"claim {place}", verdict) for place, verdict in enumerate(verdicts)]
    table = Table.of_text("claims", ["statement", "verdict"], rows, ())
    study = Study(name="small", campaigns={".": "table1"})
    report = StudyReport(study, {}, (SectionReport(Section(title="Tested"), None, (table,)),))
    assert report.findings == {
        "Tested": ["4 claims: 2 confirmed, 1 contradicted, 1 undecided.", "Contradicted: claim 1."]
    }


def test_no_section_no_findings():
    assert StudyReport(Study(name="small", campaigns={".": "table1"}), {}, ()).findings == {}
