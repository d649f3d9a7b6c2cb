"""Detectors: they check published states and request recomputation; they have no access to faults."""

from mavfi.detectors.detector import Alarm, Detector
from mavfi.detectors.limits import MissionLimits
from mavfi.detectors.model import Model, check_fits
from mavfi.detectors.registry import detector_names, load_detector
from mavfi.detectors.scoring import Reading, Scorer, ScoringDetector, Threshold
from mavfi.detectors.training import Recorder, Recording

__all__ = [
    "Alarm",
    "Detector",
    "MissionLimits",
    "Model",
    "Reading",
    "Recorder",
    "Recording",
    "Scorer",
    "ScoringDetector",
    "Threshold",
    "check_fits",
    "detector_names",
    "load_detector",
]
