"""Recorded flights: readers, one module per file format, and detectors trained on and applied to them."""

from mavfi.extras.logs.reader import FlightLogReader, Layout, LoggedMessage, Number, open_flight_log

__all__ = ["FlightLogReader", "Layout", "LoggedMessage", "Number", "open_flight_log"]
