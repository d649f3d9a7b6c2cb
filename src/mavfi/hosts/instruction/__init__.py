"""Instruction-level fault injection: injected runs fork from a golden flight at the injected calls."""

from mavfi.hosts.instruction.flights import InjectedFlights, fly_instruction_faults, fly_with_publications

__all__ = ["InjectedFlights", "fly_instruction_faults", "fly_with_publications"]
