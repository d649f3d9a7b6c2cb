"""Full duplication of a function: every instruction that can be duplicated, with addresses compared."""

from typing import Any

from mavfi.extras.hardening.duplicate import candidates
from mavfi.extras.hardening.plan import FunctionPlan, signature_text
from mavfi.ir.module import digest_of
from mavfi.ir.parser import parse_module
from mavfi.ir.sources import cached_source


def full_plan(kernel: str, function: Any, signature: tuple[Any, ...]) -> FunctionPlan:
    """Plan that duplicates all of a compiled function for a signature.

    Args:
        kernel: Kernel of the pipeline that calls it.
        function: The compiled function.
        signature: Numba types of its arguments.

    Raises:
        NotInstrumentableError: The function has an unknown construct.
        BuildError: The compiler crashed.
    """
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
