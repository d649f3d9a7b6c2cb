"""Presentation of ledgers and flights: tables, figures, pictures, explanations; analysis is in `mavfi.analysis`."""
