import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavfi.errors import BadInputError
from mavfi.extras.paper.failure_rate import (
    Estimate,
    ExposedKernel,
    UpsetConfig,
    altitude_factor,
    find_upsets,
    total_failures,
    upsets_per_instruction,
)


def fixed(value):
    return {"value": value, "low": value, "high": value}


def upsets(**changes):
    return UpsetConfig.model_validate(
        {
            "name": "toy",
            "fit_per_mbit": fixed(1000),
            "unprotected_mbit": 0.05,
            "visible": 0.1,
            "altitude": fixed(0),
            "instructions_per_second": 1e9,
            **changes,
        }
    )


# ---- formulas ----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("altitude", "factor"),
    [(0, 1), (120, 1.12), (500, 1.6), (1000, 2.5), (1609, 4.3), (3000, 12.6), (5000, 45), (10668, 434), (12192, 628)],
)
def test_the_flux_grows_with_altitude_as_in_the_standard(altitude, factor):
    assert altitude_factor(altitude) == pytest.approx(factor, rel=0.03)


def test_upsets_per_instruction_by_hand():
    # 0.05 Mbit x 1000 FIT/Mbit = 50 FIT, of which a tenth is visible: 5e-9 per hour; 3.6e12 instructions in that hour
    assert upsets_per_instruction(upsets()).value == pytest.approx(5e-9 / 3.6e12)


def test_the_band_has_the_ends_of_flux_and_fit():
    band = upsets_per_instruction(
        upsets(fit_per_mbit={"value": 1000, "low": 100, "high": 2000}, altitude={"value": 120, "low": 0, "high": 1000})
    )
    middle = 5e-9 / 3.6e12
    assert band.low == pytest.approx(0.1 * middle)
    assert band.high == pytest.approx(2 * altitude_factor(1000) * middle)
    assert band.low < band.value < band.high


def test_kernels_add_up_and_their_intervals_as_standard_errors_do():
    kernels = [ExposedKernel(10.0, Estimate(0.5, 0.2, 0.9)), ExposedKernel(10.0, Estimate(0.1, -0.3, 0.4))]
    total = total_failures(kernels, 1.0)
    assert total.value == 6.0
    assert total.low == pytest.approx(6.0 - 5.0) and total.high == pytest.approx(6.0 + 5.0), "3, 4, 5"
    assert total_failures([], 1.0) == Estimate(0, 0, 0)


def test_shipped_upsets_have_sources():
    shipped_upsets = find_upsets()
    assert set(shipped_upsets.sources) == set(UpsetConfig.model_fields) - {"name", "sources"}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ("altitude: {value: 5, low: 6, high: 9}", "value: 5: allowed: 6 to 9, its low and high"),
        ("altitude: {value: 5, low: 0, high: 30000}", "altitude: 30000 m: allowed: up to 18000"),
        ("altitude: {value: 5, low: 0, high: 9}\nsources: {fit: x}", "sources: 'fit': not known; allowed: fit_"),
    ],
)
def test_wrong_upsets_are_refused(tmp_path, changes, message):
    path = tmp_path / "mine.yaml"
    path.write_text(
        "name: x\nfit_per_mbit: {value: 1, low: 1, high: 1}\nunprotected_mbit: 1\nvisible: 1\n"
        f"instructions_per_second: 1\n{changes}\n"
    )
    with pytest.raises(BadInputError) as raised:
        find_upsets(str(path))
    assert str(path) in str(raised.value) and message in str(raised.value)


# ---- dilution ----------------------------------------------------------------------------------------------------
@given(st.floats(1, 1e12), st.floats(1e-6, 1), st.floats(0, 1e12))
def test_idle_instructions_raise_the_coverage_and_save_no_mission(instructions, harm, idle):
    """Of the faults in a diluted kernel, the share instructions / (instructions + idle) goes where harm is done."""
    share = instructions / (instructions + idle)
    exposed = ExposedKernel(instructions, Estimate(harm, harm / 2, harm))
    diluted = ExposedKernel(instructions + idle, Estimate(harm * share, harm * share / 2, harm * share))
    assert 1 - diluted.harm.value >= 1 - exposed.harm.value
    assert math.isclose(diluted.failures(1e-20).value, exposed.failures(1e-20).value, rel_tol=1e-9)
    apart = total_failures([exposed, ExposedKernel(idle, Estimate(0.0, 0.0, 0.0))], 1e-20)
    assert math.isclose(apart.value, exposed.failures(1e-20).value, rel_tol=1e-9)
