"""The README's sentence on hardening, and the table of requirements."""

from tools.markers import GENERATED, ROOT


def test_the_readme_says_what_the_page_says():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    block = readme.partition("<!-- hardening:begin -->")[2].partition("<!-- hardening:end -->")[0].strip()
    answer = block.partition("): ")[2]
    assert answer.startswith("Protect ") and "It does not buy missions" in answer
    assert answer in (GENERATED / "hardening.md").read_text(encoding="utf-8")
