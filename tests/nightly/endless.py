"""What must be noticed."""

from mavfi.numerics.jit import kernel_jit


@kernel_jit
def read_at(values, index):
    """Reads at the given place."""
    return values[index]


@kernel_jit
def turn_for_ever(step):
    """Never ends."""
    total = 0.0
    while total >= 0.0:
        total += step
    return total
