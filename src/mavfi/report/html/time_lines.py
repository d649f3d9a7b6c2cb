"""Time lines of published fields around a fault: selection of the most affected fields, and their samples."""

import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from mavfi.campaign.divergence import Publication
from mavfi.states import STATES, Stage

BEFORE, AFTER = 1.0, 4.0
"""Time window before and after the fault (s)."""
MOST = 6
"""Maximum number of time lines."""
SAMPLES = 260
"""Approximate maximum number of samples per line."""
_LARGEST = 1e300  # replaces infinite values


class Site(NamedTuple):
    """A numeric field of a published state."""

    state: str
    field: str
    element: int | None = None

    @property
    def label(self) -> str:
        """Display name."""
        return f"{self.state}.{self.field}" + ("" if self.element is None else f"[{self.element}]")


Line = tuple[np.ndarray, np.ndarray]
"""Instants (s) and values. Shapes (n,), (n,)."""


def time_lines(
    published: Mapping[str, Sequence[Publication]], at: float, site: str, wrong: str = ""
) -> list[dict[str, Any]]:
    """Time lines of the injected field, or of the first wrong one, and of those that differ most from the golden run.

    They are in data-flow order after the first.

    Args:
        published: Publications by role of the flight; the result is empty without those of the golden run and of
            another flight.
        at: Instant of the fault (s).
        site: Site of the fault, as text.
        wrong: First field that the injected kernel published wrong, as text; "" = none, or not known.
    """
    near = {role: _near(publications, at) for role, publications in published.items() if publications}
    if "golden" not in near or len(near) < 2:
        return []
    injected = near.get("injected") or near["recovered"]
    own = _site(site)
    first = [one for one in (own or _site(wrong),) if one is not None]
    scores = {site: _difference(near["golden"], injected, site) for site in _candidates() if site not in first}
    worst = sorted((site for site in scores if scores[site] > 0), key=lambda site: -scores[site])[: MOST - len(first)]
    shown = first + [site for site in scores if site in worst]
    ends = {role: min(1e-6 * published[role][-1].time_us, at + AFTER) for role in near}
    return [_line(site, near, at, ends, is_site=site == own) for site in shown]


def _near(publications: Sequence[Publication], at: float) -> dict[str, list[Publication]]:
    """Publications in the time window around an instant, by state, with the last one before the window."""
    found: dict[str, list[Publication]] = {}
    for publication in publications:
        time_s = 1e-6 * publication.time_us
        if time_s > at + AFTER:
            break
        own = found.setdefault(publication.state.spec.name, [])
        if time_s < at - BEFORE:
            own.clear()
        own.append(publication)
    return found


def _site(text: str) -> Site | None:
    """Parse the text of a numeric state field, e.g. "planning.trajectory.x[3]"; None for sites of other kinds."""
    found = re.fullmatch(r"(\w+\.\w+)\.(\w+)(?:\[(\d+)\])?", text)
    if found is None or found[1] not in STATES:
        return None
    spec, in_elements = STATES[found[1]], STATES[found[1]].in_elements(found[2])
    if not in_elements and found[2] not in (spec.header_dtype.names or ()):  # e.g. the number of elements
        return None
    return Site(found[1], found[2], int(found[3] or 0) if in_elements else None)


def _candidates() -> list[Site]:
    """Scalar fields of all states except sensor states, in data-flow order."""
    return [
        Site(spec.name, field.name)
        for spec in STATES.values()
        if spec.stage is not Stage.SENSOR
        for field in spec.header
        if field.name != "scan"
    ]


def _samples(own: Mapping[str, Sequence[Publication]], site: Site) -> Line:
    publications = own.get(site.state, ())
    times, values = [], []
    for publication in publications:
        part = publication.state.header if site.element is None else publication.state.elements
        place = site.element or 0
        if place < len(part):
            times.append(1e-6 * publication.time_us)
            values.append(float(part[site.field][place]))
    return np.array(times), np.array(values, np.float64)


def _difference(golden: Mapping[str, Any], injected: Mapping[str, Any], site: Site) -> float:
    """Largest difference at equal instants, relative to the range of the golden run; infinite if not finite."""
    (first_t, first), (second_t, second) = _samples(golden, site), _samples(injected, site)
    if len(first) == 0 or len(second) == 0:
        return 0.0
    held = first[np.clip(np.searchsorted(first_t, second_t + 1e-9, side="right") - 1, 0, None)]
    with np.errstate(invalid="ignore", over="ignore"):
        apart = np.abs(second - held)
        apart[(second == held) | (np.isnan(second) & np.isnan(held))] = 0.0
        span = float(np.ptp(first[np.isfinite(first)])) if np.isfinite(first).any() else 0.0
    largest = float(np.nan_to_num(apart, nan=np.inf).max())
    return largest / (span + 1e-3)


def _line(
    site: Site, near: Mapping[str, Mapping[str, Sequence[Publication]]], at: float, ends: Mapping[str, float], *,
    is_site: bool,
) -> dict[str, Any]:  # fmt: skip
    """One time line; `ends` has the instant until which a flight's last value is held, by role."""
    unit = STATES[site.state].find(site.field).unit
    lines = {role: _thinned(*_held(*_samples(own, site), at - BEFORE, ends[role])) for role, own in near.items()}
    return {
        "label": site.label, "unit": "" if unit == "-" else unit, "site": is_site,
        "window": [round(at - BEFORE, 4), round(at + AFTER, 4)],
        "data": {role: [[round(t, 4) for t in line[0].tolist()], [_number(v) for v in line[1].tolist()]]
                 for role, line in lines.items()},
    }  # fmt: skip


def _held(times: np.ndarray, values: np.ndarray, start: float, end: float) -> Line:
    """The samples between two instants (s); a value holds until the next one, the last one until the end."""
    kept = np.append(times[1:], np.inf)[: len(times)] > start
    times, values = np.maximum(times[kept], start), values[kept]
    if len(times) and times[-1] < end:
        times, values = np.append(times, end), np.append(values, values[-1])
    return times, values


def _thinned(times: np.ndarray, values: np.ndarray) -> Line:
    """Thin samples to about `SAMPLES`: every n-th, and those next to a jump above half the standard deviation."""
    step = -(-len(times) // SAMPLES)
    if step <= 1:
        return times, values
    with np.errstate(invalid="ignore", over="ignore"):
        jump = np.abs(np.diff(values, prepend=values[0])) > 0.5 * np.nanstd(values)
    kept = jump | np.append(jump[1:], False)
    kept[::step] = True
    return times[kept], values[kept]


def _number(value: float) -> float | None:
    """A value clipped to `_LARGEST` and rounded to 6 digits; None for NaN."""
    if np.isnan(value):
        return None
    return float(f"{np.clip(value, -_LARGEST, _LARGEST):.6g}")
