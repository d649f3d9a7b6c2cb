"""What earlier versions had is refused in one line that names what replaced it."""

import pytest

import mavfi
from mavfi.campaign.config import load_campaign
from mavfi.cli import run
from mavfi.config import parse
from mavfi.dropped import VALUES
from mavfi.errors import BadInputError
from mavfi.mission import MissionSpec


@pytest.mark.parametrize(("key", "value"), [pair for pair in VALUES if pair[0] in MissionSpec.model_fields])
def test_a_dropped_value_is_refused_with_the_value_to_use(key: str, value: str):
    with pytest.raises(BadInputError) as refusal:
        parse(MissionSpec, {key: value}, "mission")
    assert str(refusal.value) == f"mission: key {key!r}: {value!r}: dropped; use {VALUES[key, value]!r}"


@pytest.mark.parametrize(
    ("option", "value", "instead"), [("--dead-node", "latched", "readback"), ("--degraded", "hover", "hold")]
)
def test_a_dropped_value_of_an_option_is_refused_with_the_value_to_use(option, value, instead, capsys):
    assert run(["fly", option, value]) == 2
    message = f"mavfi: {option}: {value!r}: dropped; use {instead!r}\n"
    assert capsys.readouterr().err == message


def test_a_dropped_key_is_refused():
    with pytest.raises(BadInputError, match="mission: key 'copies': dropped; no replacement: one copy"):
        parse(MissionSpec, {"copies": 2}, "mission")


def test_a_dropped_campaign_is_refused():
    with pytest.raises(BadInputError, match="campaign 'replicas': dropped; use detector_instructions"):
        load_campaign("replicas")


def test_recovery_is_no_target_of_faults():
    for text in ("memory:recovery.restarts_left", "instruction:recovery"):
        with pytest.raises(BadInputError, match="kernel 'recovery': dropped; no fault in recovery lost a mission"):
            mavfi.draw(text)


@pytest.mark.parametrize("name", ["autoencoder_all", "isolation_forest", "pca"])
def test_learned_models_of_all_fields_are_refused_with_the_one_that_stays(name, capsys):
    refusal = "dropped; use limits: it brings back as many missions"
    assert run(["fly", "--detector", name]) == 2
    assert capsys.readouterr().err == f"mavfi: detector {name!r}: {refusal}\n"
    with pytest.raises(BadInputError, match=f"kernel {name!r}: {refusal}"):
        mavfi.draw(f"instruction:{name}")
    assert run(["train", "--baselines"]) == 2
    assert "--baselines: dropped; no replacement: a model of a library becomes a detector" in capsys.readouterr().err
