"""Reads a ledger or a flight and shows it: tables, figures, pictures, explanations.  Computes nothing new."""
