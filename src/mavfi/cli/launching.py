"""Where the program `mavfi` starts itself again: with fixed addresses, for faults in instructions."""

import sys
from pathlib import Path

_is_program = False


def as_program() -> None:
    """Note that this process is the program `mavfi`, which may be replaced; a test or a notebook may not."""
    global _is_program  # noqa: PLW0603 (the one fact about this process)
    _is_program = True


def fix_addresses() -> None:
    """Start the program again with fixed addresses and hashing, where the system allows it and it is not so yet."""
    if not _is_program:
        return
    from mavfi.faults.instruction.launch import start_with_fixed_addresses

    start_with_fixed_addresses([sys.executable, *sys.orig_argv[1:]])


def fix_addresses_for(directory: Path) -> None:
    """The same where a ledger holds faults in instructions, flown with fixed addresses.

    Args:
        directory: Where the ledger is.

    Raises:
        BadInputError: There is none.
    """
    from mavfi.campaign.run import FIXED_ADDRESSES
    from mavfi.campaign.store import Store

    with Store.open(directory) as store:
        fixed = store.meta(FIXED_ADDRESSES)
    if fixed:
        fix_addresses()
