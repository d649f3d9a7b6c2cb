"""Advice which instructions of the kernels to duplicate, from a ledger, and its certificate from fresh faults."""
