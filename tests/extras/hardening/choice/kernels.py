"""A kernel with a branch, a loop, stores and a call of libm."""

import math

import numpy as np

from mavfi.extras.hardening.battery import copied
from mavfi.extras.hardening.observed import FlightPart, ObservedFunction
from mavfi.faults.levels.instruction.variant import signature_of, variant_for
from mavfi.numerics.jit import kernel_jit


@kernel_jit
def smooth(values, out):
    total = 0.0
    for i in range(len(values)):
        x = values[i] * 0.5 + 1.0
        if x > 2.0:
            x = 4.0 - x
        out[i] = x * x - total * 0.25
        total += out[i]
    return math.sin(total)


def calls(count=4):
    random = np.random.default_rng(2)
    return [(random.uniform(0.0, 4.0, 9), np.zeros(9)) for _ in range(count)]


def see(function, calls, missions=1):
    """What calls, of equal types, show of a function, as golden flights do; they are dealt out to the missions."""
    variant = variant_for(function, calls[0])
    parts = []
    for number in range(missions):
        of_mission = calls[number::missions]
        executions = sum(variant.tally(*copied(args))[1] for args in of_mission)
        parts.append(FlightPart(f"dense-{number}", np.asarray(executions), len(of_mission), of_mission))
    return ObservedFunction(function, function.py_func.__name__, signature_of(calls[0]), variant, parts)
