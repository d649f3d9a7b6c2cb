"""Which instructions of the kernels to duplicate, by the faults of a ledger, and missions that fly with them."""
