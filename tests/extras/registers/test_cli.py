"""What `mavfi inject` prints: operands and names of mappings are data, not markup."""

import os

import pytest

from mavfi.cli import run
from mavfi.record import Injection

DETAILS = {
    "pid": 7,
    "thread": 8,
    "address": "0x7ffd",
    "library": "[vdso]",
    "offset": "0x10",
    "symbol": "f[abi:cxx11]+0x4",
    "instruction": "mov rax, qword ptr [rdi + 8]",
    "access": "read",
    "register": "rdi",
    "width": 64,
    "stopped_us": 900,
}


@pytest.mark.parametrize("activated", [True, False])
def test_operands_and_names_in_brackets_are_printed(capsys, monkeypatch, activated):
    injection = Injection("register", "rdi", 0.0, 3, "0x1", "0x9", activated=activated, details=DETAILS)
    monkeypatch.setattr("mavfi.extras.registers.inject", lambda *arguments: arguments[-1](injection))
    assert run(["inject", "--pid", str(os.getpid())]) == 0
    text = capsys.readouterr().out
    for name in ("mov rax, qword ptr [rdi + 8]", "[vdso]", "f[abi:cxx11]+0x4", "0x1 → 0x9"):
        assert name in text
    assert ("NOT injected as planned" in text) == (not activated)
