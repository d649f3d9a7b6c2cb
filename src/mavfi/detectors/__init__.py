"""Detectors: they watch published states and ask for recomputation; they know no faults.

Training (`mavfi.detectors.training`) is not imported here: it needs scikit-learn, which flying does not.
"""

from mavfi.detectors.detector import Alarm, Detector
from mavfi.detectors.model import Model, check_fits
from mavfi.detectors.recorder import Recorder, Recording
from mavfi.detectors.registry import detector_names, load_detector

__all__ = ["Alarm", "Detector", "Model", "Recorder", "Recording", "check_fits", "detector_names", "load_detector"]
