"""Detectors: they check published states and request recomputation; they have no access to faults."""

from mavfi.detectors.detector import Alarm as Alarm
from mavfi.detectors.detector import Detector as Detector
