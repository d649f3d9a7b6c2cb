"""The table of costs: its rows, what is left out and why, and which detectors fly again."""

from benchmarks import detectors
from benchmarks.detectors import BASELINES, DETECTORS, is_due, models_of, table, unmeasured
from mavfi.errors import NotInstalledError, SpecMismatchError
from mavfi.extras.bench.bench import load_bench
from mavfi.extras.paper.overheads import STAGES, Cost

SPENT = dict.fromkeys(STAGES, 0.002)


def cost(seconds, kernels=0.1, shown=100):
    return Cost(kernels, {**SPENT, "all": seconds}, SPENT, shown, 0.005, 1.0)


def test_a_row_has_medians_and_extremes_of_flights():
    key = ("published", "duplicate", "paper")
    lines = table({key: [cost(0.01), cost(0.03), cost(0.02)]}, 4, 3, {}).splitlines()
    assert lines[-1] == ("| `duplicate`, `paper` | `published` | 200.00 | 20.00 (10.00 – 30.00) | – | 2.00 | 0.50 |")
    assert "the kernels take 100 ms (`published`) of a flight" in lines[0]


def test_every_scheme_of_the_bench_that_is_no_bound_is_measured():
    names = {arm.detector for arm in load_bench("mavfi-bench-1").arms.values() if arm.detector}
    assert {name for name, _, _ in DETECTORS} == names - {"random", "oracle"}
    assert len(BASELINES) == 6


def test_what_is_not_measured_is_named_with_the_reason(monkeypatch, tmp_path):
    def loaded(scenario, name, profile, models):
        if name == "pca":
            raise NotInstalledError("package 'pyod': not installed")
        if scenario.autopilot.name == "hardened" and name in BASELINES:
            raise SpecMismatchError(f"{models}: no model is trained")

    monkeypatch.setattr(detectors, "detector_for", loaded)
    names = ("gaussian", "pca", "matrix_profile")
    keys = [(autopilot, name, "paper") for autopilot in ("published", "hardened") for name in names]
    assert set(unmeasured(keys, None)) == {key for key in keys if key[1] != "gaussian"}
    found = unmeasured(keys, tmp_path)
    assert set(found) == {key for key in keys if key[1] == "pca" or key == ("hardened", "matrix_profile", "paper")}
    text = table({}, 4, 3, found)
    assert "Not measured: `pca` (`published`), `pca` (`hardened`): package 'pyod': not installed." in text
    assert "Not measured: `matrix_profile` (`hardened`): there is no model for this autopilot profile." in text
    assert str(tmp_path) not in text


def test_a_slow_detector_is_measured_once_in_each_mission():
    fast, slow = [cost(0.1)] * 4, [cost(5.0)] * 4
    assert [is_due(repeat, fast, 4) for repeat in (-1, 0, 1, 2)] == [True] * 4
    assert [is_due(repeat, slow, 4) for repeat in (-1, 0, 1, 2)] == [True, True, False, False]


def test_only_models_of_other_libraries_are_those_of_the_folder(tmp_path):
    assert models_of("gaussian", tmp_path) is None and models_of("pca", tmp_path) == tmp_path


def test_a_selection_is_printed_and_not_written(monkeypatch, capsys):
    flown = []

    def measured(mission, name, profile, models):
        flown.append((mission.autopilot, mission.environment, mission.seed, name))
        return cost(0.01)

    monkeypatch.setattr(detectors, "cost", measured)
    monkeypatch.setattr(detectors, "PAGE", None)
    for name, value in {"N": "1", "SEEDS": "1", "ONLY": "duplicate pca", "MODELS": ""}.items():
        monkeypatch.setenv(name, value)
    detectors.main()
    assert len(flown) == 2 * (1 + 2) and {name for *_, name in flown} == {"duplicate"}
    text = capsys.readouterr().out
    assert text.count("| `duplicate`, `paper` |") == 2 and "needs MODELS, a folder of models" in text
