"""Options of register faults in processes that fly a mission, for the commands of other extras."""

from typing import Annotated

import typer

from mavfi.cli.console import check_name, check_seed
from mavfi.cli.panels import FAULT
from mavfi.errors import BadInputError

_LONGEST_S = 1e6
"""Instants from this one on are refused (s)."""

RegistersOption = Annotated[
    str | None,
    typer.Option(help="Of register faults: general, fp, or all (default).", rich_help_panel=FAULT),
]
SeedOption = Annotated[
    int | None,
    typer.Option(
        help="Draws instruction, register, bit of --register-fault; 0 by default.",
        rich_help_panel=FAULT,
    ),
]


def register_options(registers: str | None, seed: int | None, *, has_fault: bool) -> tuple[str, int]:
    """Values of `--registers` and `--register-seed`, which need a register fault."""
    from mavfi.extras.registers.fault import REGISTERS

    for option, value in (("--registers", registers), ("--register-seed", seed)):
        if value is not None and not has_fault:
            raise BadInputError(f"{option}: {value}: allowed: with --register-fault only")
    check_name("--registers", registers or "all", REGISTERS)
    check_seed("--register-seed", seed or 0)
    return registers or "all", seed or 0


def instant(option: str, text: str, example: str = "octomap@20") -> tuple[str, int]:
    """Parse node and instant (s), as in `example`, to name and microseconds; raises `BadInputError` if invalid."""
    node, separator, seconds = text.partition("@")
    try:
        time_s = float(seconds)
    except ValueError:
        separator = ""
        time_s = 0.0
    if not separator or not 0.0 <= time_s < _LONGEST_S:
        raise BadInputError(f"{option}: {text!r}: allowed: NODE@SECONDS, e.g. {example}")
    return node, round(1e6 * time_s)
