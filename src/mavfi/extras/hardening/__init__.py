"""Which instructions of the kernels to duplicate, chosen from the faults of a ledger, and missions that fly with them."""
