"""Writes a flight as a table of comma-separated values: one row per control tick, plain column names."""

import csv
from pathlib import Path

from mavfi.errors import BadInputError
from mavfi.flight_log import COLUMNS, FlightLog


def write_csv(log: FlightLog, path: Path) -> int:
    """Write the columns of a flight; numbers are written so that reading gives the same bits.

    Args:
        log: The flight.
        path: File, written over.

    Returns:
        How many rows were written.

    Raises:
        BadInputError: The place cannot be written.
    """
    try:
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(COLUMNS)
            writer.writerows([repr(float(value)) for value in row] for row in log.rows)
    except OSError as error:
        raise BadInputError(f"{path}: cannot be written ({error.strerror})") from None
    return len(log.rows)
