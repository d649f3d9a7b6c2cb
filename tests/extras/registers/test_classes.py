"""Classes of registers and names of functions."""

import pytest

from mavfi.extras.registers.classes import class_of, function_of


@pytest.mark.parametrize(
    ("register", "kind"),
    [
        ("xmm3", "FP (XMM, YMM)"),
        ("ymm0", "FP (XMM, YMM)"),
        ("rflags", "flags"),
        ("rsp", "stack (rsp, rbp)"),
        ("ebp", "stack (rsp, rbp)"),
        ("r12d", "general"),
        ("al", "general"),
    ],
)
def test_registers_have_classes(register, kind):
    assert class_of(register) == kind


@pytest.mark.parametrize(
    ("symbol", "name"),
    [
        ("schedulerExecuteTask.part.0+0x3", "schedulerExecuteTask"),
        ("pidController+0x1", "pidController"),
        ("", "(no symbol)"),
    ],
)
def test_functions_are_named_without_what_the_compiler_added(symbol, name):
    assert function_of(symbol) == name
