"""What faults in instructions can be in: the functions of a mission's kernels, of its plug-ins, and of its detector.

A plug-in (planner, map, flight controller, detector) names its functions in the attribute `compiled`: a tuple of
functions of `kernel_jit`, or a mapping from names to them.  Their callees are part of their machine code.  The plug-in
calls them by name as it does without faults; only a flight that counts or injects them has others called instead.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from mavfi.detectors.detector import Detector, custom_parts, part_of
from mavfi.detectors.registry import check_kernel
from mavfi.errors import BadInputError, not_known
from mavfi.faults.fault import CallFault
from mavfi.faults.plug_ins import PlugIn, plug_ins
from mavfi.numerics.jit import is_compiled
from mavfi.pipeline.functions import ENTRIES, PLAIN, Compiled, FlightFunctions, KernelFunctions
from mavfi.states import DETECTORS, KERNELS, PLANNERS, PLUG_INS, REPLACEABLE

if TYPE_CHECKING:
    from mavfi.mission import Scenario

_DETECTOR = "detector"


# ---- plug-ins of a mission -------------------------------------------------------------------------------------------
def detector_address(detector: Detector | None) -> str:
    """Name of a custom detector, or of the custom part of a detector; "" = there is none."""
    parts = custom_parts(detector)
    if not parts:
        return ""
    return parts[-1].requested_as or f"{type(parts[-1]).__module__}:{type(parts[-1]).__name__}"


def find_plug_in(text: str, scenario: "Scenario", detector: Detector | None) -> PlugIn | None:
    """The plug-in of a mission that a request means; None = none of them."""
    of_detector = [(part.source, type(part).__name__) for part in custom_parts(detector)]
    for plug_in in plug_ins_of(scenario, detector):
        if plug_in.is_called(text):
            return plug_in
        if plug_in.role == _DETECTOR and any(text in names for names in of_detector):
            return plug_in
    return None


def plug_ins_of(scenario: "Scenario", detector: Detector | None = None) -> list[PlugIn]:
    """The plug-ins of a mission under a detector."""
    of_kernels = {name: scenario.kernels.get(name, "") for name in REPLACEABLE}
    return plug_ins(
        {
            "map": scenario.map.kind,
            "planner": scenario.planner.name,
            **of_kernels,
            "flight_controller": scenario.flight_controller,
            "detector": detector_address(detector),
        }
    )


# ---- declared functions ---------------------------------------------------------------------------------------------
def declared_functions(owner: Any, what: str) -> dict[str, Compiled]:
    """The functions that a class, or an object, names in its attribute `compiled`, by name.

    Args:
        owner: The class or object.
        what: What it is, for messages.

    Raises:
        BadInputError: It names none, or something else than functions of `kernel_jit` with names of their own.
    """
    declared: Any = getattr(owner, "compiled", ())
    if is_compiled(declared):
        declared = (declared,)
    if isinstance(declared, Mapping):
        named = [(name, _unbound(function)) for name, function in declared.items()]
    elif isinstance(declared, (tuple, list)):
        named = [(_name_of(_unbound(function)), _unbound(function)) for function in declared]
    else:
        raise BadInputError(f"{what}: compiled: {declared!r:.60}: allowed: a tuple of functions, a class attribute")
    if not named:
        raise BadInputError(
            f"{what}: names no compiled function, and plain Python is not injected; allowed: functions of kernel_jit "
            "in its attribute `compiled` (docs/how-to/own-kernels.md)"
        )
    functions: dict[str, Compiled] = {}
    for name, function in named:
        if not is_compiled(function):
            raise BadInputError(f"{what}: compiled: {name!r:.60}: is not compiled by kernel_jit; allowed: one that is")
        if not isinstance(name, str) or not name.isidentifier():
            raise BadInputError(f"{what}: compiled: {name!r:.60}: is no name; allowed: {{'name': function}}")
        if name in functions:
            raise BadInputError(f"{what}: compiled: {name!r}: twice; allowed: {{'name': function}} with two names")
        functions[name] = function
    return functions


def _unbound(function: Any) -> Any:
    """The function in a static method, as the body of a class has it."""
    if isinstance(function, staticmethod):
        return function.__func__
    return function


def _name_of(function: Any) -> str:
    """Name of a function, or what it is if it has none, for messages."""
    return str(getattr(function, "__name__", repr(function)))


def counter_name(kernel: str, role: str, entry: str) -> str:
    """Name under which calls of a function are counted; functions of plug-ins may have the names of others."""
    if role:
        return f"{kernel}.{entry}"
    return entry


# ---- targets --------------------------------------------------------------------------------------------------------
@dataclass(frozen=True, slots=True)
class InjectionTarget:
    """A kernel, plug-in or detector with its compiled functions.

    Attributes:
        name: Its name in faults and tables.
        functions: Its functions, by name; none if it is refused.
        kernel: The kernel in whose steps they are called, a key of `states.KERNELS`; "" = none.
        role: Kind of the plug-in, as in `states.PLUG_INS`; "" = of mavfi.
        parts: Detectors that call them and replace them by themselves, see `Detector.instrument`.
        refusal: Why no fault can be in it; "" = faults can.
    """

    name: str
    functions: Mapping[str, Compiled]
    kernel: str = ""
    role: str = ""
    parts: tuple[Any, ...] = ()
    refusal: str = ""

    @property
    def in_detector(self) -> bool:
        """Whether it is a detector: only flights with it call its functions."""
        return self.role == _DETECTOR or (not self.role and self.name in DETECTORS)

    @property
    def counters(self) -> dict[str, str]:
        """Name of each function, by the name under which its calls are counted."""
        return {counter_name(self.name, self.role, entry): entry for entry in self.functions}


class Targets:
    """The targets of a mission under a detector, in the order of the data flow."""

    def __init__(self, scenario: "Scenario", detector: Detector | None = None) -> None:
        self._scenario = scenario
        self._detector = detector
        self._plug_ins = plug_ins_of(scenario, detector)
        by_role = {plug_in.role: plug_in for plug_in in self._plug_ins}

        # Kernels of mavfi, or the plug-ins in their place.
        targets = []
        for kernel, spec in KERNELS.items():
            name = kernel
            entries = spec.functions
            if kernel == "planner":
                name = scenario.planner.name
                entries = PLANNERS.get(name, ())
            replacements = [plug_in for plug_in in self._plug_ins if PLUG_INS[plug_in.role].kernel == kernel]
            if replacements:
                targets.append(self._of_plug_in(replacements[0]))
            elif entries:
                targets.append(InjectionTarget(name, {entry: getattr(PLAIN, entry) for entry in entries}, kernel))
        if "flight_controller" in by_role:
            targets.append(self._of_plug_in(by_role["flight_controller"]))

        # Detectors of mavfi, then others.
        custom = custom_parts(detector)
        for source in DETECTORS:
            part = part_of(detector, source)
            if part is not None and part not in custom:
                targets.append(InjectionTarget(source, dict(part.compiled), parts=(part,)))
        if _DETECTOR in by_role:
            targets.append(self._of_detector(by_role[_DETECTOR]))
        self._targets = {target.name: target for target in targets}
        self._refuse_shared_functions()

    def _of_plug_in(self, plug_in: PlugIn) -> InjectionTarget:
        """A plug-in whose class names its functions."""
        kernel = PLUG_INS[plug_in.role].kernel
        try:
            factory = _factory(plug_in)
            functions = declared_functions(factory, f"{plug_in.role.replace('_', ' ')} {plug_in.address!r}")
        except BadInputError as error:
            return InjectionTarget(plug_in.name, {}, kernel, plug_in.role, refusal=str(error))
        return InjectionTarget(plug_in.name, functions, kernel, plug_in.role)

    def _of_detector(self, plug_in: PlugIn) -> InjectionTarget:
        """The custom parts of a detector."""
        functions: dict[str, Compiled] = {}
        instrumenting = []  # parts that replace their functions by themselves
        refusal = ""
        for part in custom_parts(self._detector):
            try:
                functions |= declared_functions(part, f"detector {plug_in.address!r}")
            except BadInputError as error:
                refusal = str(error)
                continue
            if type(part).instrument is not Detector.instrument:
                instrumenting.append(part)
        if functions:
            refusal = ""
        return InjectionTarget(plug_in.name, functions, "", _DETECTOR, tuple(instrumenting), refusal)

    def _refuse_shared_functions(self) -> None:
        """Refuse plug-ins that name a function of another target: nothing tells whose call is injected."""
        owners: dict[int, str] = {}
        of_mavfi_first = sorted(self._targets.items(), key=lambda item: bool(item[1].role))
        for name, target in of_mavfi_first:
            for entry, function in target.functions.items():
                other = owners.setdefault(id(function), name)
                if target.role and other != name:
                    refusal = f"{name}: compiled: {entry!r}: is a function of {other}, too; allowed: one of its own"
                    self._targets[name] = replace(target, functions={}, refusal=refusal)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the kernels and plug-ins that faults can be in; detectors are not among them."""
        return tuple(name for name, target in self._targets.items() if not target.refusal and not target.in_detector)

    def find(self, name: str) -> InjectionTarget:
        """The target that a request means.

        Raises:
            BadInputError: The mission has no such target, or it is a plug-in without compiled functions.
        """
        allowed = [target.name for target in self._targets.values() if not target.refusal]
        called = self._name_of(name)
        if called not in self._targets:
            check_kernel(name, self._scenario.planner.name, self._detector, allowed)  # raises
        target = self._targets[called]
        if target.refusal:
            raise BadInputError(f"kernel {name!r}: {target.refusal}; or one of {', '.join(allowed)}")
        return target

    def _name_of(self, text: str) -> str:
        """The name of the target that a request means; the text itself, if it means none."""
        if text in self._targets:
            return text
        plug_in = find_plug_in(text, self._scenario, self._detector)
        if plug_in is not None:
            return plug_in.name
        if text == "planner":
            return self._scenario.planner.name
        return text

    def of_fault(self, fault: CallFault) -> InjectionTarget:
        """The target of a fault.

        Raises:
            BadInputError: See `find`; or it has no function of that name any more.
        """
        target = self.find(fault.kernel)
        if fault.has_site and fault.entry not in target.functions:
            raise BadInputError(f"kernel {fault.kernel!r}: function {not_known(fault.entry, target.functions)}")
        return target

    @contextmanager
    def instrumented(self, functions: Mapping[str, Callable[..., Any]]) -> Iterator[KernelFunctions]:
        """The table of functions for a flight in which these are called instead, by the names of their counters.

        Detectors call those of theirs meanwhile.
        """
        stand_ins = []
        instrumented_parts = []
        for target in self._targets.values():
            replacements = {entry: functions[key] for key, entry in target.counters.items() if key in functions}
            # Detectors that replace functions by themselves take theirs.
            for part in target.parts:
                own_entries = [entry for entry in replacements if entry in part.compiled]
                part.instrument({entry: replacements.pop(entry) for entry in own_entries})
                instrumented_parts.append(part)
            # Plug-ins call functions by name, as without faults: stand-ins are called in the place of these.
            if target.role:
                stand_ins += [(target.functions[entry], other) for entry, other in replacements.items()]
        of_kernels = {name: functions.get(name, getattr(PLAIN, name)) for name in ENTRIES}
        try:
            yield FlightFunctions(**of_kernels, stand_ins=tuple(stand_ins))
        finally:
            for part in instrumented_parts:
                part.instrument({})


def _factory(plug_in: PlugIn) -> Any:
    """The class of a plug-in, imported."""
    if plug_in.role == "map":
        from mavfi.pipeline.maps import find_map

        return find_map(plug_in.address)
    if plug_in.role == "planner":
        from mavfi.pipeline.planners import find_search

        return find_search(plug_in.address)
    if plug_in.role in REPLACEABLE:
        from mavfi.pipeline.ppc import find_kernel

        return find_kernel(plug_in.role, plug_in.address)
    from mavfi.sim.controller import find_controller

    return find_controller(plug_in.address)
