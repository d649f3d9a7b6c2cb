"""Faults in inter-kernel states: one bit of one field of one publication, or of several.

As text: `null`, `state:planning.waypoint.x`, `state:planning.trajectory.x[3]:bit=62@5.0`,
`state:control.command.vx:set=nan@10..12` (see `faults.changes`).
"""

import re
from typing import Any, NamedTuple

from mavfi.errors import BadInputError
from mavfi.faults.acted_on import CounterWatch
from mavfi.faults.changes import is_change, split_site
from mavfi.faults.fault import FaultSite, FliesFrom
from mavfi.faults.fields import find_published
from mavfi.faults.injector import Injector
from mavfi.faults.operations import VALUE_OPERATIONS
from mavfi.faults.strata import EACH_CLASS, WHOLE_WORD, WORD_BITS, WORDS
from mavfi.levels.campaign import SampledCampaign
from mavfi.levels.level import DECIMAL, SECONDS, WHOLE, Level, parse_fields
from mavfi.levels.smaller import smaller_changes
from mavfi.levels.state.fault import LIFETIME, StateFault
from mavfi.levels.state.injector import StateInjector
from mavfi.levels.state.request import StateRequest, accepts
from mavfi.levels.state.sampling import StateSampler, StateSampling, null_fault
from mavfi.levels.state.smaller import fewer_fields, shorter_faults, single_bit_faults
from mavfi.states import PPC_STAGES, STATES, StateSpec, states_with, unknown

_SITE = re.compile(r"(?P<path>[^\[\]]+)(\[(?P<element>\d+)\])?")
"""A site in the text of a fault: path of the state or field, and index of a list element."""


class ParsedSite(NamedTuple):
    """A state, the name of a field, and the index of an element, as written in a text; None = it is drawn."""

    state: StateSpec
    field: str | None
    element: int | None


class StateLevel(Level):
    """Faults in inter-kernel states."""

    fault = StateFault
    sampling = StateSampling
    sampler = StateSampler
    local = True
    can_wait = True
    form = (
        "state:STATE[.FIELD][[ELEMENT]][:bit=N][:also=FIELD.N[+...]][:width=N][:times=N][:lasts=S][:share=P][@SECONDS]"
        " or state:STATE[.FIELD][[ELEMENT]]:OPERATION[:times=N][:every=N][:share=P][:lasts=S][@INSTANT]"
    )
    options = {
        "bit": WHOLE,
        "also": (r"\w+\.\d{1,4}(\+\w+\.\d{1,4})*", "further fields and their bits, e.g. y.60+z.3", str),
        "width": WHOLE,
        "times": WHOLE,
        "lasts": SECONDS,
        "share": (DECIMAL, "a number above 0, to 1", float),
    }
    operations = VALUE_OPERATIONS
    reductions = {
        "fields": fewer_fields,
        "publications": shorter_faults,
        "width": single_bit_faults,
        "bit": smaller_changes,
    }
    absent = ("published", "no such publication came")
    null_fault = staticmethod(null_fault)

    def null(self) -> StateRequest:
        """The null fault: the empty mask on the way-point in force."""
        return StateRequest(STATES["planning.waypoint"], "x", null=True)

    def parse(self, text: str, localization: str) -> StateRequest:
        """See `Level.parse`."""
        if is_change(text):
            return self._parse_operation(text, localization)
        parts = self.parts_of(text)
        spec, field, element = self._parse_site(parts.site, localization)
        site_name = spec.name
        fields = spec.fields
        if field is not None:
            site_name = f"{spec.name}.{field}"
            fields = (spec.find(field),)
        # Bits and duration.
        bits = max(WORD_BITS[candidate.dtype] for candidate in fields)
        lifetime = dict(parts.options)
        bit = lifetime.pop("bit", None)
        also = _further_fields(lifetime.pop("also", ""))
        if also and (field is None or bit is None):
            raise BadInputError("also: goes with a field and its bit; allowed: FIELD:bit=N:also=...")
        last = (bit or 0) + lifetime.get("width", 1) - 1
        if last >= bits:
            raise BadInputError(f"no bit {last} in {site_name}; allowed: 0 to {bits - 1}")
        if "lasts" in lifetime:
            lifetime["lasts_s"] = lifetime.pop("lasts")
        StateFault(FaultSite(spec.name, field or spec.fields[0].name), bit=bit, also=also, **lifetime)  # checks them
        return StateRequest(spec, field, element, bit, parts.time_us, lifetime=lifetime, also=also)

    def _parse_site(self, text: str, localization: str) -> ParsedSite:
        """A state or a field of it, and an element."""
        match = _SITE.fullmatch(text)
        if match is None:
            self.not_understood()
        spec, field = _find_state(match["path"], localization)
        if match["element"] is None:
            return ParsedSite(spec, field, None)
        site_name = spec.name
        has_elements = bool(spec.elements)
        if field is not None:
            site_name = f"{spec.name}.{field}"
            has_elements = spec.in_elements(field)
        element = int(match["element"])
        if not has_elements:
            raise BadInputError(f"element [{element}]: {site_name} is no list; allowed: no element")
        return ParsedSite(spec, field, element)

    def _parse_operation(self, text: str, localization: str) -> StateRequest:
        """A fault that changes a value by an operation, or in publications that a trigger selects."""
        site, what = split_site(text)
        spec, field, element = self._parse_site(site, localization)
        change, bit, time_us, lasts_s = parse_fields(what, "flip")
        lifetime: dict[str, Any] = {}
        if lasts_s > 0.0:
            lifetime["lasts_s"] = lasts_s

        # A bit that is not given is drawn.
        checked_bit = bit
        if change.operation.name == "flip" and bit is None:
            checked_bit = 0
        # Without a field, one that allows the operation is drawn.
        checked_field = field
        if field is None:
            checked_field = next((each.name for each in spec.fields if accepts(each, change.operation)), None)
        checked_site = FaultSite(spec.name, checked_field or spec.fields[0].name)
        StateFault(checked_site, bit=checked_bit, change=change, **lifetime)  # checks all of it
        return StateRequest(spec, field, element, bit, time_us, lifetime=lifetime, change=change)

    def text_of(self, fault: StateFault) -> str:
        """See `Level.text_of`."""
        if fault.change is not None:
            return f"state:{fault.where}:{fault.change.with_fields(fault.bit, fault.time_us, fault.lasts_s)}"
        options = ""
        if fault.bit is not None:
            options = f":bit={fault.bit}"
        if fault.also:
            options += f":also={'+'.join(f'{name}.{bit}' for name, bit in fault.also)}"
        for name in ("width", "times", "lasts_s", "share"):
            value = getattr(fault, name)
            if value != LIFETIME[name]:
                options += f":{name.removesuffix('_s')}={value}"
        return f"state:{fault.where}{options}@{fault.time_us / 1e6}"

    def seed_of(self, fault: StateFault) -> int | None:
        """See `Level.seed_of`: an intermittent fault draws its publications."""
        if fault.share < 1.0 or (fault.change is not None and fault.change.when.share < 1.0):
            return fault.seed
        return None

    def flies_from(self, fault: StateFault) -> FliesFrom:
        """See `Level.flies_from`; the purpose of a null fault is to exercise the injector."""
        if fault.is_null or fault.counts_publications:
            return FliesFrom.TAKE_OFF
        return FliesFrom.CHECKPOINT

    def inject(self, loop: Any, fault: StateFault, detector: Any) -> Injector:
        """See `Level.inject`."""
        watch = loop.taps.injector
        if not isinstance(watch, CounterWatch):
            watch = None
        injector = loop.taps.injector = StateInjector(fault, watch)
        loop.watch_losses()
        return injector

    def columns(self, fault: StateFault) -> dict[str, Any]:
        """See `Level.columns`."""
        site = fault.where
        spec = STATES[fault.where.state]
        columns: dict[str, Any] = {
            "stage": str(spec.stage),
            "kernel": spec.writer,
            "state": site.state,
            "field": site.field,
            "element": site.element,
        }
        if fault.change is not None:
            columns["operation"] = fault.change.name
        elif fault.bit is not None:
            columns["operation"] = "flip"
        # what is drawn from all bits is the population of faults without strata
        if fault.stratum not in (WHOLE_WORD, EACH_CLASS):
            columns["population"] = fault.stratum
        return columns

    def about(self, campaign: SampledCampaign) -> dict[str, Any]:
        """See `Level.about`."""
        sampling = campaign.sampling
        unit = {"stage_balanced": "stage", "groups": "group", "messages": "message"}[sampling.scheme]
        shares = sorted(sampling.strata.items(), reverse=True)
        strata = " : ".join(f"{WORDS.get(name, name)} {share:g}" for name, share in shares)
        how = f"drawn {strata}, fields: {sampling.sites}"
        if sampling.groups and all(group.strata is not None for group in sampling.groups):
            how = "drawn from the bits that each group names"
        if sampling.when != "uniform":
            how += f", publications: {sampling.when}"
        about: dict[str, Any] = {"each": unit, "how": how}
        if sampling.scheme == "stage_balanced":
            about["stages"] = list(PPC_STAGES)
        return about


def _further_fields(text: str) -> tuple[tuple[str, int], ...]:
    """Further fields and their bits, from the option `also`; "" = none."""
    if not text:
        return ()
    flips = []
    for part in text.split("+"):
        name, _, bit = part.partition(".")
        flips.append((name, int(bit)))
    return tuple(flips)


def _find_state(path: str, localization: str) -> tuple[StateSpec, str | None]:
    """State and field of a path "STATE.FIELD", or "STATE" alone; names contain dots."""
    state = path
    field = ""
    if path not in STATES:
        state, _, field = path.rpartition(".")
    if state not in STATES:
        raise BadInputError(unknown("state", path, states_with(localization)))
    spec = find_published(state, localization)
    if not field:
        return spec, None
    return spec, spec.find(field).name
