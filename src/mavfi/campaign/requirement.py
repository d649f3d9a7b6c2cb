"""A requirement on a campaign's result, as text: "sdc < 5 %", "recommended: success >= 95 %"."""

import re
from collections.abc import Mapping
from dataclasses import dataclass

from mavfi.errors import BadInputError, not_known

EFFECTS = ("masked", "sdc", "crash", "hang", "exception", "due")
"""Measures of what a fault does to the computation; due = a crash, a hang or an exception."""
MISSION = ("success", "mission lost")
"""Measures of what a fault does to the mission; of programs without a mission or a verdict there is none."""
WATCHED = ("detected", "recovered", "false alarms")
"""Measures of an arm with a detector: of faults, of missions lost without the detector, of golden runs."""
MEASURES = (*EFFECTS, *MISSION, *WATCHED)
_FORM = "MEASURE < 5 % or MEASURE >= 95 %, with ARM: before it for an arm"
_REQUIREMENT = re.compile(r"(?:([^:]+):)?\s*([a-zA-Z ]+?)\s*(<=|>=|<|>)\s*(\d+(?:\.\d*)?)\s*%")


@dataclass(frozen=True, slots=True)
class Requirement:
    """A bound on a rate.

    Attributes:
        text: As the user wrote it, in plain spaces.
        arm: The arm whose runs count; "" = the campaign's own mission, without a detector.
        measure: One of `MEASURES`.
        comparison: "<", "<=", ">" or ">=".
        limit: The bound, 0 to 1.
    """

    text: str
    arm: str
    measure: str
    comparison: str
    limit: float

    @staticmethod
    def parse(text: str) -> "Requirement":
        """The requirement in a text.

        Raises:
            BadInputError: It is not in the form, or the measure is not known.
        """
        match = _REQUIREMENT.fullmatch(text.strip())
        if match is None:
            raise BadInputError(f"{text!r}: not understood; allowed: {_FORM}")
        arm, measure, comparison, number = match.groups()
        name = " ".join(measure.lower().split())
        if name not in MEASURES:
            raise BadInputError(f"{text!r}: measure {not_known(measure, MEASURES)}")
        percent = float(number)
        if percent > 100.0:
            raise BadInputError(f"{text!r}: {number} %: allowed: 0 to 100")
        return Requirement(" ".join(text.split()), (arm or "").strip(), name, comparison, percent / 100.0)

    def of(self, detectors: Mapping[str, str]) -> "Requirement":
        """The requirement with its arm; a measure of detectors is that of the only arm with one, unless it names one.

        Args:
            detectors: The detector of each arm of the campaign; "" = none.

        Raises:
            BadInputError: The campaign has no such arm, or the measure needs one.
        """
        if self.arm and self.arm not in detectors:
            raise BadInputError(f"{self.text!r}: arm {not_known(self.arm, detectors)}")
        if self.measure not in WATCHED:
            return self
        watched = [arm for arm, detector in detectors.items() if detector]
        arm = self.arm
        if not arm and len(watched) == 1:
            arm = watched[0]
        if arm not in watched:
            names = ", ".join(watched) or "none here"
            raise BadInputError(f"{self.text!r}: is about one arm with a detector; allowed: ARM: with {names}")
        return Requirement(self.text, arm, self.measure, self.comparison, self.limit)
