"""Shrunk rates: the formula, level by level."""

import pytest

from mavfi.extras.hardening.target import SiteRates

SITE = ("fmul", "line 9", (0, 3))


def test_a_site_without_injections_has_the_rate_of_its_line():
    rates = SiteRates(
        [(("fmul", "line 9", (0, 1)), True), (("fmul", "line 9", (0, 2)), True), (("add", "line 2", (1, 0)), False)]
    )
    whole = 2 / 3
    opcode = (2 + 4 * whole) / (2 + 4)
    line = (2 + 4 * opcode) / (2 + 4)
    assert rates.of(SITE) == pytest.approx((0 + 4 * line) / (0 + 4))


def test_many_injections_of_the_site_outweigh_its_groups():
    others = [(("fmul", "line 9", (7, 7)), False)] * 50
    rates = SiteRates([*others, *[(SITE, True)] * 1000])
    assert rates.of(SITE) > 0.98


def test_without_injections_every_rate_is_zero():
    assert SiteRates([]).of(SITE) == 0.0
