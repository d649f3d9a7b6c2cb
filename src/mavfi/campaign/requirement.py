"""A requirement on a campaign's result, as text: "sdc < 5 %", "gad: success >= 95 %", "fi.lost - gad.lost > 2 %"."""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass

from mavfi.errors import BadInputError, not_known

EFFECTS = ("masked", "sdc", "crash", "hang", "exception", "due")
"""Measures of what a fault does to the computation; due = a crash, a hang or an exception."""
MISSION = ("success", "mission lost")
"""Measures of what a fault does to the mission; of programs without a mission or a verdict there is none."""
WATCHED = ("detected", "recovered", "false alarms")
"""Measures of an arm with a detector: of faults, of missions lost without the detector, of golden runs."""
MEASURES = (*EFFECTS, *MISSION, *WATCHED)
COMPARABLE = (*EFFECTS, *MISSION)
"""Measures of faults, whose difference between two settings or campaigns can be required."""
FI = "fi"
"""Name of the setting without an arm in differences."""
CAMPAIGNS = ("A", "B")
"""Names of two compared campaigns in differences."""
_SHORT = {"lost": "mission lost"}
_FORM = "MEASURE < 5 % or MEASURE >= 95 %, with ARM: before it for an arm; or NAME.MEASURE - NAME.MEASURE < 2 %"
_DIFFERENCE = re.compile(
    r"(?:([^:]+):)?\s*([\w-]+)\.([a-zA-Z ]+?)\s*-\s*([\w-]+)\.([a-zA-Z ]+?)\s*(<=|>=|<|>)\s*(-?\d+(?:\.\d*)?)\s*%"
)
_REQUIREMENT = re.compile(r"(?:([^:]+):)?\s*([a-zA-Z ]+?)\s*(<=|>=|<|>)\s*(\d+(?:\.\d*)?)\s*%")


@dataclass(frozen=True, slots=True)
class Requirement:
    """A bound on a rate, or on the difference of two.

    Attributes:
        text: As the user wrote it, in plain spaces.
        arm: The arm whose runs count; "" = the campaign's own mission, without a detector.
        measure: One of `MEASURES`.
        comparison: "<", "<=", ">" or ">=".
        limit: The bound, 0 to 1; of a difference -1 to 1.
        minus: The two arms, `FI`, or campaigns in a difference, the first less the second; () = it is none.
    """

    text: str
    arm: str
    measure: str
    comparison: str
    limit: float
    minus: tuple[str, ...] = ()

    @staticmethod
    def parse(text: str) -> "Requirement":
        """The requirement in a text.

        Raises:
            BadInputError: It is not in the form, or the measure is not known.
        """
        words = " ".join(text.split())
        difference = _DIFFERENCE.fullmatch(words)
        if difference is not None:
            arm, first, measure, second, other_measure, comparison, number = difference.groups()
            name = _measure(text, measure, COMPARABLE)
            if _measure(text, other_measure, COMPARABLE) != name:
                raise BadInputError(f"{text!r}: a difference of {measure} and {other_measure}: allowed: one measure")
            if first == second:
                raise BadInputError(f"{text!r}: {first} less itself; allowed: two names")
            limit = _limit(text, number, lowest=-100.0)
            return Requirement(words, (arm or "").strip(), name, comparison, limit, (first, second))
        match = _REQUIREMENT.fullmatch(words)
        if match is None:
            raise BadInputError(f"{text!r}: not understood; allowed: {_FORM}")
        arm, measure, comparison, number = match.groups()
        name = _measure(text, measure, MEASURES)
        return Requirement(words, (arm or "").strip(), name, comparison, _limit(text, number, lowest=0.0))

    def of(self, detectors: Mapping[str, str]) -> "Requirement":
        """The requirement with its arm; a measure of detectors is that of the only arm with one, unless it names one.

        Args:
            detectors: The detector of each arm of the campaign; "" = none.

        Raises:
            BadInputError: The campaign has no such arm, or the measure needs one.
        """
        if self.minus:
            for name in self.minus:
                if name not in (FI, *detectors):
                    raise BadInputError(f"{self.text!r}: setting {not_known(name, (FI, *detectors))}")
            if self.arm:
                raise BadInputError(f"{self.text!r}: {self.arm}: allowed: no ARM: before a difference of settings")
            return self
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

    def of_campaigns(self) -> "Requirement":
        """The requirement on two compared campaigns.

        Raises:
            BadInputError: It is about one campaign, or settings of it.
        """
        if sorted(self.minus) != sorted(CAMPAIGNS):
            raise BadInputError(
                f"{self.text!r}: is not about A and B; allowed: 'A.MEASURE - B.MEASURE < 2 %', with ARM: before it"
            )
        return self


def _measure(text: str, words: str, allowed: Collection[str]) -> str:
    """The measure in a text, e.g. "mission lost" for "Lost"."""
    name = " ".join(words.lower().split())
    name = _SHORT.get(name, name)
    if name not in allowed:
        raise BadInputError(f"{text!r}: measure {not_known(words, allowed)}")
    return name


def _limit(text: str, number: str, lowest: float) -> float:
    """The bound in a text in per cent, as a share."""
    percent = float(number)
    if not lowest <= percent <= 100.0:
        raise BadInputError(f"{text!r}: {number} %: allowed: {lowest:g} to 100")
    return percent / 100.0
