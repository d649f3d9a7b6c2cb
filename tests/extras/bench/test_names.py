from mavfi import config
from mavfi.detectors.gate import SOURCE as GATE
from mavfi.detectors.registry import contains, of_monitored_fields, trainable
from mavfi.states import BASELINES

WITHOUT_TRAINING = {"recommended", "checksum", "duplicate", "oracle", "random"}


def test_detectors_of_all_fields_are_entry_points_with_a_file_each():
    of_all_fields = set(trainable()) - set(of_monitored_fields())
    assert of_all_fields == {"limits", "autoencoder_all"}
    assert set(config.names("detectors")) == {*trainable(["bench"]), *WITHOUT_TRAINING}


def test_baselines_need_their_libraries_and_have_no_gate():
    baselines = set(trainable(["bench"])) - set(trainable())
    assert baselines == set(BASELINES)
    assert not any(contains(name, "tuned", GATE) for name in baselines)
