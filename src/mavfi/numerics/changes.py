"""Changes of an array, selected after it was written."""

import numpy as np

from mavfi.numerics.jit import kernel_jit


@kernel_jit
def select_changes(
    places: np.ndarray, before: np.ndarray, after: np.ndarray, changed: np.ndarray, changed_before: np.ndarray,
    changed_after: np.ndarray,
) -> int:  # fmt: skip
    """Select the entries whose bits have changed.

    Args:
        places: Flat indices of the written values, in write order. Shape (n,), int32.
        before: Previous values. Shape (n,) or longer, float32.
        after: Values now. Shape (n,), float32.
        changed: Output: places whose value has changed, in order. Shape (n,) or longer, int32.
        changed_before: Output: their previous values. Same length, float32.
        changed_after: Output: their values. Same length, float32.

    Returns:
        Number of changed entries.
    """
    before_bits, after_bits = before.view(np.uint32), after.view(np.uint32)
    count = 0
    for i in range(places.shape[0]):
        if before_bits[i] != after_bits[i]:
            changed[count] = places[i]
            changed_before[count] = before[i]
            changed_after[count] = after[i]
            count += 1
    return count
