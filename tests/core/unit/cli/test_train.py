import json

import pytest

from mavfi.cli import run


@pytest.mark.slow
@pytest.mark.long
def test_train_writes_models_that_fly(capsys, tmp_path):
    assert run(["train", "--flights", "3", "--check", "1", "--workers", "1", "--out", str(tmp_path), "--json"]) == 0
    models = json.loads(capsys.readouterr().out)["models"]
    assert {(m["kind"], m["profile"]) for m in models} == {
        *((kind, profile) for kind in ("gaussian", "autoencoder") for profile in ("paper", "tuned")),
        ("limits", "tuned"),
    }
    flights = {m["kind"]: m["provenance"]["flights"] for m in models}
    assert flights.pop("gaussian") == flights.pop("autoencoder") == 3 and flights == {"limits": 6}
    assert all(m["false_alarms"][world]["hours"] > 0 for m in models for world in ("training", "factory"))
    assert len(list(tmp_path.glob("*.json"))) == 5
    arguments = ["--detector", "gaussian", "--models", str(tmp_path), "--json"]
    assert run(["fly", "--environment", "sparse", "--seed", "7", *arguments]) == 0
    assert json.loads(capsys.readouterr().out)["detector"] == "gaussian (paper)"
    assert run(["fly", "--autopilot", "hardened", *arguments]) == 2
    assert "mavfi train" in capsys.readouterr().err
