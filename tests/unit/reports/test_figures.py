from mavfi.reports import figures


def _entry(target, population, rate):
    hurt = {"n": 4, "rate": rate, "low": 0.0, "high": 1.0, "successes": 2}
    return {
        "environment": "dense", "target": target, "setting": "fi", "population": population, "fails_or_slower": hurt,
    }  # fmt: skip


def test_groups_with_strata_of_their_own_are_all_drawn():
    entries = [_entry("x", "mantissa", 0.0), _entry("x", "sign_exponent", 0.5), _entry("y", "sign", 0.25)]
    axes = figures.states({"campaign": {"law": "groups"}, "by_target": entries}).axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["x", "y"]
    assert axes.containers[0].lines[0].get_xdata().tolist() == [0.5, 0.25]


def test_nothing_to_show_is_no_figure():
    empty = {"campaign": {"law": "groups", "stack": "published"}, "success": [], "by_target": [], "flight_times": []}
    assert figures.success(empty) is figures.states(empty) is figures.flight_time(empty) is None


def test_failures_are_censored():
    entry = {"environment": "dense", "setting": "fi", "n": 4, "inflations": [0.0, 0.5], "censored": 2}
    axes = figures.flight_time({"flight_times": [entry]}).axes[0]
    assert axes.lines[0].get_ydata().max() == 0.5


def test_the_whole_curve_of_flight_times_is_in_sight():
    entry = {"environment": "dense", "setting": "fi", "n": 4, "inflations": [-0.17, 0.0, 0.5], "censored": 1}
    axes = figures.flight_time({"flight_times": [entry]}).axes[0]
    left, right = axes.get_xlim()
    assert left < -0.17 and right > 0.5
    assert [axes.xaxis.get_major_formatter()(share, 0) for share in (-0.06, -0.001, 0.0, 0.06)] == [
        "-6 %", "0 %", "0 %", "+6 %"
    ]  # fmt: skip
