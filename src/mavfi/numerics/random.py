"""Random numbers whose whole state is four unsigned integers in kernel memory (xoshiro256+, Blackman & Vigna 2021)."""

import numpy as np

from mavfi.numerics.jit import kernel_jit

_TWO_POW_53 = 9007199254740992.0


def seed_generator(seed: int, *address: int) -> np.ndarray:
    """Generator state for a seed and an address (purpose, run, ...).

    Args:
        seed: Mission seed.
        address: Spawn key: one stream per purpose, so that no stream shifts another.

    Returns:
        Shape (4,), uint64, not all zero.
    """
    state = np.random.SeedSequence(seed, spawn_key=address).generate_state(4, np.uint64)
    state[0] |= np.uint64(1)
    return state


@kernel_jit
def uniform(state: np.ndarray) -> float:
    """Next number in [0, 1); changes `state` (shape (4,), uint64)."""
    result = state[0] + state[3]
    shifted = state[1] << np.uint64(17)
    state[2] ^= state[0]
    state[3] ^= state[1]
    state[1] ^= state[2]
    state[0] ^= state[3]
    state[2] ^= shifted
    state[3] = (state[3] << np.uint64(45)) | (state[3] >> np.uint64(19))
    return np.float64(result >> np.uint64(11)) / _TWO_POW_53
