"""What flights, campaigns and recovery expect of a detector, as a suite of tests; mavfi's own detectors pass it."""

from mavfi.testing import DetectorContract


class TestMyDetector(DetectorContract):
    """Among others: `check` changes nothing, `start` forgets the flight before, golden flights have no alarm."""

    detector = "my_detector:MyDetector"
