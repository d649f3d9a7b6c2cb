"""What the levels of faults share: the base of faults, changes, operations, sampling, strata."""
