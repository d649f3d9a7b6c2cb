"""Recorded flights: readers, one module for each file format, and detectors trained on them and judging them."""

from mavfi.flight_logs.reader import FlightLogReader, Layout, LoggedMessage, Number, open_flight_log

__all__ = ["FlightLogReader", "Layout", "LoggedMessage", "Number", "open_flight_log"]
