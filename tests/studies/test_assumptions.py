"""The study of assumptions: design, fit against naive counterparts, published page, and a small study to the end."""

import numpy as np
import pytest
import scipy

from mavfi.config import parse, read_yaml
from studies.assumptions.__main__ import DEFINITION, fly_study, load_study
from studies.assumptions.design import AssumptionStudy
from studies.assumptions.fit import (
    Counts,
    EnvironmentFlights,
    Flights,
    deviance,
    fit,
    judge,
    paper_counts,
)
from studies.assumptions.page import changes, page
from studies.assumptions.stored import FOLDER, stored_rows
from tools.results import RESULTS

ENVIRONMENTS = ("factory", "farm", "sparse", "dense")
SETTINGS = {"dr_gaussian": "dr_gaussian", "dr_autoencoder": "dr_autoencoder"}


@pytest.fixture(scope="module")
def study() -> AssumptionStudy:
    return load_study()


def flights(rate: float, n: int, random: np.random.Generator) -> Flights:
    """Independent runs, one per world, of which a share succeeds."""
    worlds = np.array([f"world {index}" for index in range(n)])
    return Flights(random.random(n) < rate, np.zeros(n, bool), np.full(n, 40.0), worlds)


def as_in_the_paper(n: int, background: float, random: np.random.Generator) -> dict[str, EnvironmentFlights]:
    """Runs whose success rates are the paper's / background."""
    result = {}
    for name in ENVIRONMENTS:
        rates = {setting: paper_counts(name, setting).rate / background for setting in ("golden", "fi", *SETTINGS)}
        faulty = {setting: flights(rates[setting], n, random) for setting in ("fi", *SETTINGS)}
        result[name] = EnvironmentFlights(flights(rates["golden"], n, random), faulty)
    return result


# ---- design ----------------------------------------------------------------------------------------------------------
def test_readings_differ_from_their_anchor_in_one_axis_and_make_campaigns(study: AssumptionStudy) -> None:
    for reading, axis_changes in study.single_changes().items():
        for change in axis_changes:
            anchor = study.anchor(change.anchor)
            assert [axis for axis, value in reading.values if value != anchor[axis]] == [change.axis]
        campaign = study.campaign(reading, 0)
        assert len(campaign.environments) == 4
        assert campaign.first_seed >= study.rounds.first_seed > 10_000


def test_rounds_and_judgement_fly_different_missions(study: AssumptionStudy) -> None:
    reading = study.anchor("states")
    seeds = [set(study.campaign(reading, number).seeds) for number in range(study.rounds.number)]
    seeds.append(set(study.judged_campaign(reading, ()).seeds))
    assert len(set.union(*seeds)) == sum(map(len, seeds))


# ---- fit -------------------------------------------------------------------------------------------------------------
def test_deviance_is_that_of_the_likelihoods() -> None:
    counts = Counts(27, 30)
    likelihood = scipy.stats.binom.logpmf
    expected = 2 * (likelihood(27, 30, 0.9) - likelihood(27, 30, 0.8))
    assert float(deviance(counts, 0.8)) == pytest.approx(expected)


def test_a_background_and_a_time_limit_are_recovered(study: AssumptionStudy) -> None:
    random = np.random.default_rng(2)
    restart = study.value("deaths", "restart")
    golden = flights(1.0, 400, random)
    faulty = flights(paper_counts("dense", "fi").rate / paper_counts("dense", "golden").rate, 400, random)
    dense = {"dense": EnvironmentFlights(golden, {"fi": faulty})}
    assert fit(dense, restart, study.value("losses", "background")).environments["dense"].best == pytest.approx(
        0.85, abs=0.04
    )

    # golden flights take 30 to 50 s; those with a fault as long, if they arrive
    slow = Flights(golden.success, golden.died, random.uniform(30, 50, 400), golden.worlds)
    slow_faulty = Flights(faulty.success, faulty.died, random.uniform(30, 50, 400), faulty.worlds)
    dense = {"dense": EnvironmentFlights(slow, {"fi": slow_faulty})}
    assert fit(dense, restart, study.value("losses", "time_limit")).environments["dense"].best == pytest.approx(
        47, abs=1.5
    )


def test_judgement_accepts_what_predicts_the_paper_and_rejects_what_does_not(study: AssumptionStudy) -> None:
    random = np.random.default_rng(3)
    restart = study.value("deaths", "restart")
    losses = study.value("losses", "flown")
    right = as_in_the_paper(300, 1.0, random)
    frozen = fit(right, restart, losses)
    accepted = judge(frozen, as_in_the_paper(300, 1.0, random), restart, losses, SETTINGS)
    assert accepted.p_value > 0.05
    useless = {"dr_gaussian": "fi", "dr_autoencoder": "fi"}
    assert judge(frozen, right, restart, losses, useless).p_value < 0.01


# ---- the page --------------------------------------------------------------------------------------------------------
def test_the_published_page_is_that_of_the_stored_rows() -> None:
    published = (RESULTS / "assumptions.md").read_text(encoding="utf-8")
    assert published == page(FOLDER, "tables/assumptions")
    assert len(published.split()) <= 900


@pytest.mark.slow
@pytest.mark.long
def test_a_small_study_flies_and_resumes(tmp_path):
    data = read_yaml(DEFINITION)
    values = data["axes"]["where"]["values"]
    data["axes"]["where"]["values"] = {name: values[name] for name in ("monitored", "all_states")}
    data["axes"]["bit"]["values"] = {name: data["axes"]["bit"]["values"][name] for name in ("word", "sign_exponent")}
    data["axes"]["difficulty"]["values"] = {
        name: data["axes"]["difficulty"]["values"][name] for name in ("ours", "arrival")
    }
    anchor = dict(data["anchors"]["states"]["values"])
    data |= {
        "environments": ["farm"],
        "anchors": {"states": {"values": anchor, "vary": ["where", "losses"]}},
        "detectors": {"gate": data["detectors"]["gate"]},
        "rounds": {"missions": 2, "number": 1, "frozen": 1, "judged_missions": 2, "first_seed": 30_000},
        "training_flights": 2,
    }
    small = parse(AssumptionStudy, data, "small")
    folder = fly_study(small, tmp_path / "out", 1)
    # its rows have the columns of the published ones, and make a page and a figure
    for published in FOLDER.glob("*.csv"):
        written = stored_rows(published.stem, folder)
        other_environments = {"factory", "sparse", "dense"}
        assert written and set(written[0]) == set(stored_rows(published.stem)[0]) - other_environments, published.stem
    text = page(folder, "tables", small.environments)
    assert "readings (" in text and f"| {stored_rows('detectors', folder)[0]['where']} | gate |" in text
    assert len(changes(stored_rows("axes", folder), small.environments)) == 1
    # it resumes: nothing is flown again, and all rows are the same
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert fly_study(small, tmp_path / "out", 1) == folder
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
