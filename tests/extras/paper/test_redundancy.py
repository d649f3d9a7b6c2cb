"""The performance model behind Fig. 8: formulas by hand, properties, tables, and `mavfi redundancy`."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavfi import config
from mavfi.analysis.views import VIEWS
from mavfi.cli.commands import run
from mavfi.config import VehicleConfig, shipped
from mavfi.errors import BadInputError
from mavfi.extras.paper.failure_rate import UpsetConfig
from mavfi.extras.paper.redundancy import (
    CANNOT_HOVER,
    GRAVITY,
    DesignConfig,
    energy_ratio,
    find_design,
    max_acceleration,
    payload,
    performance,
    safe_speed,
    shipped_designs,
    summary,
    time_ratio,
)
from tests.core.unit.analysis.handmade import flown, golden, injected, runs


def design(**changes):
    return DesignConfig(**{"name": "toy", "mass": 1.0, "max_thrust": 20.0, **changes})


# ---- formulas, by hand -------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("acceleration", "period", "distance", "speed"),
    [
        (2.0, 0.0, 9.0, 6.0),  # sqrt(2 a d)
        (2.0, 1.0, 8.0, 4.0),  # 4 * 1 + 16 / 4 = 8
        (5.0, 2.0, 25.0, 8.708287),  # 5 (sqrt(4 + 10) - 2)
        (0.0, 1.0, 8.0, 0.0),
        # MAVBench's own range of speeds, with the acceleration and range of its launch files
        (6.0, 0.0, 6.5, 8.832),
        (6.0, 4.0, 6.5, 1.573),
    ],
)
def test_the_safe_speed_is_that_from_which_the_vehicle_stops_in_time(acceleration, period, distance, speed):
    found = safe_speed(acceleration, period, distance)
    assert found == pytest.approx(speed, abs=5e-4)
    if acceleration:
        assert found * period + found**2 / (2 * acceleration) == pytest.approx(distance)


def test_payload_grows_by_a_heat_sink_or_by_a_board_for_each_processor():
    board = {"board_mass": 0.1, "heatsink": 0.01, "processor_power": 4.0}
    assert [payload(design(**board), n) for n in (1, 2, 3)] == pytest.approx([0.14, 0.18, 0.22])
    assert payload(design(replicated="board", **board), 3) == pytest.approx(0.42)


def test_both_laws_of_the_largest_acceleration():
    assert max_acceleration(design(), 1.25) == pytest.approx(16.0 - GRAVITY)
    assert max_acceleration(design(acceleration="tilt"), 1.25) == pytest.approx(
        GRAVITY * math.sqrt((16 / GRAVITY) ** 2 - 1)
    )
    assert max_acceleration(design(), 20.0 / GRAVITY) == max_acceleration(design(), 5.0) == 0.0


def test_ratios_of_time_and_energy():
    single, three = performance(design()), performance(design(), 3)
    assert time_ratio(three, single) == single.speed / three.speed > 1
    assert energy_ratio(three, single) == pytest.approx(single.speed / three.speed * (three.mass / single.mass) ** 1.5)
    assert time_ratio(three, single, speed_limit=1.0) == 1.0, "both fly at the limit"
    between = (single.speed + three.speed) / 2
    assert time_ratio(three, single, between) == pytest.approx(between / three.speed)
    heavy = performance(design(max_thrust=12.0, heatsink=0.02, processor_power=5.0), 3)
    assert heavy.speed == 0 and time_ratio(heavy, single) == CANNOT_HOVER


# ---- shipped calibrations ----------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("name", "dmr", "tmr"),
    [
        ("airsim_uav", 1.028, 1.058),
        ("dji_spark", 1.253, 1.881),
        ("airsim_uav_tdp", 1.026, 1.060),
        ("dji_spark_tdp", 1.120, 1.898),
    ],
)
def test_shipped_calibrations(name, dmr, tmr):
    """Worked out apart from this code: F/m - g, then the positive root."""
    calibrated = find_design(name)
    single = performance(calibrated)
    assert [time_ratio(performance(calibrated, n), single) for n in (2, 3)] == pytest.approx([dmr, tmr], abs=6e-4)


def test_the_airsim_uav_is_the_vehicle_that_missions_fly():
    flown, calibrated = shipped("vehicles", VehicleConfig, "airsim_quad"), find_design("airsim_uav")
    assert calibrated.mass == flown.mass
    assert calibrated.max_thrust == pytest.approx(4 * flown.max_rotor_thrust)


def test_every_band_and_input_of_the_shipped_designs_has_a_source():
    for calibrated in shipped_designs():
        inputs = {"mass", "max_thrust", "board_mass", "processor_power", "heatsink", "action_period", "sensing_range"}
        assert set(calibrated.sources) == inputs
        assert all(band.low <= getattr(calibrated, key) <= band.high for key, band in calibrated.bands.items())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name: x\nmass: 1\n", "key 'max_thrust': is required"),
        ("name: x\nmass: 1\nmax_thrust: 5\n", "5 N: cannot hover; allowed: above the weight with one processor, 10.9"),
        ("name: x\nmass: 1\nmax_thrust: 20\nthrust: 3\n", "unknown key 'thrust'"),
        (
            "name: x\nmass: 1\nmax_thrust: 20\nbands: {masses: {low: 1, high: 2}}\n",
            "'masses': not known (did you mean 'mass'?)",
        ),
        ("name: x\nmass: 1\nmax_thrust: 20\nsources: {m: me}\n", "sources: 'm': not known"),
        ("name: x\nmass: 1\nmax_thrust: 20\nbands: {mass: {low: 3, high: 2}}\n", "low: 3: allowed: at most high, 2"),
    ],
)
def test_a_wrong_vehicle_file_is_refused(tmp_path, text, message):
    path = tmp_path / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(BadInputError) as raised:
        find_design(str(path))
    assert str(path) in str(raised.value) and message in str(raised.value)


# ---- properties ----
REAL = {"allow_nan": False, "allow_infinity": False}
accelerations = st.floats(1e-3, 50, **REAL)
periods = st.floats(0, 10, **REAL)
ranges = st.floats(0.1, 100, **REAL)


@given(accelerations, periods, ranges)
def test_a_vehicle_at_its_safe_speed_stops_within_its_range_and_not_before(acceleration, period, distance):
    speed = safe_speed(acceleration, period, distance)
    assert math.isclose(speed * period + speed**2 / (2 * acceleration), distance, rel_tol=1e-9)


# ---- tables ----
def test_the_comparison_has_every_scheme_and_the_papers_figures():
    rows = VIEWS["redundancy"].table(runs(golden(1), injected(1, flown()))).entries()
    assert len(rows) == len(shipped_designs()) * 4
    tmr = {(row["vehicle"], row["calibration"]): row for row in rows if row["scheme"] == "TMR"}
    assert [row["paper"] for row in tmr.values()] == [1.06, 1.06, 1.91, 1.91]
    assert tmr["dji_spark", "logged power"]["time"] == pytest.approx(1.881, abs=1e-3)
    assert tmr["dji_spark", "thermal design power"]["band"].startswith("≥ 1.0"), "at one end it cannot hover"
    assert all(row["time"] == 1 and row["band"] is None for row in rows if row["scheme"] == "autoencoder")
    assert tmr["airsim_uav", "logged power"]["limited"] == 1.0, "it may fly faster than the mission lets it"


def test_the_summary_says_the_papers_figure_and_what_cannot_fly():
    line = summary([find_design("dji_spark")])
    assert line == [
        "dji_spark (logged power): with TMR it takes 1.88 times as long as with a detector, band 1.19–2.42; the paper: "
        "1.91 times."
    ]
    assert "with TMR it cannot hover" in summary([design(max_thrust=11.2)])[0]


# ---- command line ----
def test_the_answer_comes_first_and_the_picture_is_drawn(tmp_path, capsys):
    picture = tmp_path / "red.png"
    assert run(["redundancy", "--picture", str(picture)]) == 0
    text = capsys.readouterr().out
    assert text.startswith("airsim_uav (logged power): with TMR it takes 1.06 times as long")
    assert picture.read_bytes()[:4] == b"\x89PNG"
    assert max(map(len, text[text.index("Flight time over") :].splitlines()[:22])) <= 80, "the table is not cut"
    assert text.count("dji_spark") == 3, "sentences, and one table"


def test_bad_input_is_one_line(tmp_path, capsys):
    assert run(["redundancy", "--vehicle", "balloon"]) == 2
    assert "vehicle 'balloon': not known; allowed: airsim_uav, airsim_uav_tdp, dji_spark" in capsys.readouterr().err
    assert run(["redundancy", "--picture", str(tmp_path / "x.txt")]) == 2
    assert run(["redundancy", "--csv"]) == 2


@pytest.mark.parametrize(("kind", "model"), [("redundancy", DesignConfig), ("upsets", UpsetConfig)])
def test_shipped_configurations_are_named_as_their_files(kind, model):
    assert [config.shipped(kind, model, name).name for name in config.names(kind)] == list(config.names(kind))
