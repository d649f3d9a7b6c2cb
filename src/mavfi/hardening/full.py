"""Full duplication of a function: every instruction that can be duplicated."""

import json
from typing import Any

from mavfi.hardening.candidates import candidates
from mavfi.hardening.plan import FunctionPlan, signature_text
from mavfi.ir.build import build_apart, name_of, source_of
from mavfi.ir.digest import digest_of
from mavfi.ir.parser import parse_module


def full_plan(kernel: str, function: Any, signature: tuple[Any, ...], **more: Any) -> FunctionPlan:
    """Plan that duplicates all of a compiled function for a signature.

    Args:
        kernel: Kernel of the pipeline that calls it.
        function: The compiled function.
        signature: Numba types of its arguments.
        more: Further fields of the plan.

    Raises:
        RefusedError: The function has an unknown construct.
        BuildError: The compiler crashed.
    """
    found = json.loads(build_apart(function, signature, make))
    return FunctionPlan(
        kernel=kernel, function=name_of(function), signature=signature_text(signature), **{**found, **more}
    )  # fmt: skip


def make(function: Any, signature: tuple[Any, ...]) -> bytes:
    """The part of `full_plan` that runs in another process: digest and sites of the code."""
    source = source_of(function, signature)
    module = parse_module(source.text, source.kernel)
    return json.dumps({"ir_sha256": digest_of(module), "sites": candidates(module)}).encode()
