from mavfi import config
from mavfi.detectors.gate import SOURCE as GATE
from mavfi.detectors.registry import contains, of_monitored_fields, trainable

WITHOUT_TRAINING = {"recommended", "checksum", "duplicate", "oracle", "random"}


def test_the_detector_of_all_fields_is_an_entry_point_and_has_no_gate():
    assert set(trainable()) - set(of_monitored_fields()) == {"limits"}
    assert not contains("limits", "tuned", GATE)


def test_every_detector_has_a_file():
    assert set(config.names("detectors")) == {*trainable(), *WITHOUT_TRAINING}
