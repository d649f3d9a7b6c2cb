from mavfi.reports import text


def test_rate_with_count():
    entry = {"rate": 28 / 30, "low": 0.787, "high": 0.982, "n": 30, "successes": 28}
    assert text.rate(entry) == "93.3 [78.7, 98.2] 28/30"


def test_weighted_rate_has_no_count():
    assert text.rate({"rate": 0.5, "low": 0.25, "high": 0.75, "n": 8, "successes": None}) == "50.0 [25.0, 75.0] n=8"


def test_absent_figures():
    assert text.rate(None) == text.rate({"rate": None}) == text.percent(None) == text.number(None) == text.ABSENT


def test_changes_carry_a_sign():
    assert text.signed_percent(0.5) == "+50.0 %"
    assert text.signed_percent(-0.015) == "-1.5 %"
