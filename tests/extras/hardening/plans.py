"""Plans that duplicate everything, and flights in which every call of a function runs protected code."""

import numpy as np

from mavfi.extras.hardening.compiled import code_of
from mavfi.extras.hardening.duplicate import candidates
from mavfi.extras.hardening.observed import functions_of
from mavfi.extras.hardening.plan import FunctionPlan, signature_text
from mavfi.extras.hardening.protected import protection_of
from mavfi.flight.fly import fly
from mavfi.flight.targets import Targets
from mavfi.ir.build import environment_of, load_code, name_of
from mavfi.ir.injection.variant import signature_of
from mavfi.ir.module import digest_of
from mavfi.ir.parser import parse_module
from mavfi.ir.sources import cached_source


def full_plan(kernel, function, signature):
    """Plan that duplicates all of a compiled function, addresses compared; its time is not measured."""
    source = cached_source(function, signature)
    module = parse_module(source.text, source.kernel)
    return FunctionPlan(
        kernel=kernel,
        function=source.kernel,
        signature=signature_text(signature),
        ir_sha256=digest_of(module),
        addresses=True,
        sites=tuple(candidates(module)),
    )


def compiled(function, signature, rewrite):
    """Machine code of a rewritten function, called as the function is."""
    source = cached_source(function, signature)
    module = rewrite(parse_module(source.text, source.kernel))
    environment = environment_of(function, signature)
    loaded = load_code(code_of(module), source.wrapper, source.environment, environment)
    return lambda *args: loaded[1](None, args, None)  # the code lives as long as its engine


class ProtectedFunction:
    """A function of which planned signatures run protected code."""

    def __init__(self, function, plan):
        self.function = function
        self.plan = plan
        self.code = {}
        self.calls = 0

    def __call__(self, *args):
        signature = signature_of(args)
        if signature not in self.code:
            self.code[signature] = self.function
            protection = protection_of(self.plan, name_of(self.function), signature)
            if protection is not None:
                self.code[signature] = compiled(self.function, signature, protection)
        self.calls += self.code[signature] is not self.function
        return self.code[signature](*args)  # a SystemError would be a false alarm


def calls_of_protected_code(scenario, plan, kernels):
    """Number of protected calls in a flight that is bit for bit that of plain code."""
    targets = Targets(scenario)
    functions = {name: ProtectedFunction(own, plan) for name, own in functions_of(kernels, targets).items()}
    with np.errstate(all="ignore"), targets.instrumented(functions) as table:
        assert fly(scenario, functions=table).log.digest() == fly(scenario).log.digest()
    return sum(function.calls for function in functions.values())
