"""`mavfi shrink`: search for the smallest fault that still loses the mission."""

from typing import TYPE_CHECKING

from mavfi.cli import options
from mavfi.cli.console import console

if TYPE_CHECKING:
    from mavfi.campaign.shrink import Shrunk


def shrink(
    directory: options.Ledger,
    run_id: options.RunId,
) -> None:
    """Reduce the fault of a lost mission: shorter, fewer bits, a less significant bit.

    Prints the command that flies the smallest fault found that still loses the mission.

    Example: [bold]mavfi shrink out/reproduce dense-10000-fi-planning-0[/bold]
    """
    from mavfi.campaign.shrink import shrink as make_smaller
    from mavfi.cli.flight_text import story_table
    from mavfi.report.shrink import lines

    progress = console(error=True)
    with progress.status("flying candidates ..." if progress.is_terminal else "") as shown:
        found = make_smaller(directory, run_id, lambda count: shown.update(f"{count} candidates flown"))
    out = console()
    out.print(story_table(lines(found)))
    out.print(f"to fly it   {command(found)}", soft_wrap=True, markup=False, highlight=False)  # one line, to be copied


def command(found: "Shrunk") -> str:
    """Command that flies the smallest fault."""
    from mavfi.campaign.run import stored_campaign
    from mavfi.campaign.samplers.request import seed_of, text_of
    from mavfi.campaign.store import Store
    from mavfi.cli.flight_pages import fly_command

    spec = found.spec
    with Store.open(found.directory) as store:
        campaign = stored_campaign(store)
    overrides = campaign.arms[spec.arm].mission if spec.arm in campaign.arms else {}
    mission = campaign.spec(spec.environment, spec.seed, overrides)
    fault = found.smallest.fault
    profile = spec.detector_profile if spec.model else None
    return fly_command(mission, text_of(fault), seed_of(fault), spec.detector or "none", profile, None)
