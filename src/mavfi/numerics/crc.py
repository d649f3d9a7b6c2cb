"""CRC-32C (Castagnoli et al., IEEE Trans. Communications 41(6), 1993), as in iSCSI (RFC 3720, appendix B.4).

Polynomial 0x1EDC6F41, reflected; register and result are inverted.  Table-driven, eight bytes per step (Kounavis and
Berry, ISCC 2005, "slicing by 8").
"""

import numpy as np

from mavfi.numerics.jit import kernel_jit

_REFLECTED = 0x82F63B78
_ALL_ONES = 0xFFFFFFFF


def _tables() -> np.ndarray:
    """Row k: the remainder of each byte followed by k zero bytes. Shape (8, 256), int64."""
    table = np.zeros((8, 256), np.int64)
    first = np.arange(256)
    for _ in range(8):
        first = np.where(first & 1, (first >> 1) ^ _REFLECTED, first >> 1)
    table[0] = first
    for row in range(1, 8):
        table[row] = (table[row - 1] >> 8) ^ first[table[row - 1] & 255]
    return table


_TABLES = _tables()


@kernel_jit
def crc32c(content: np.ndarray, before: int) -> int:
    """Checksum of bytes, continued from a previous checksum.

    Args:
        content: Shape (n,), uint8.
        before: Checksum of the preceding bytes; 0 = none.
    """
    value = np.int64(before ^ _ALL_ONES)
    whole = len(content) - len(content) % 8
    for at in range(0, whole, 8):
        value ^= (
            np.int64(content[at])
            | np.int64(content[at + 1]) << 8
            | np.int64(content[at + 2]) << 16
            | np.int64(content[at + 3]) << 24
        )
        value = (
            _TABLES[7, value & 255]
            ^ _TABLES[6, value >> 8 & 255]
            ^ _TABLES[5, value >> 16 & 255]
            ^ _TABLES[4, value >> 24]
            ^ _TABLES[3, content[at + 4]]
            ^ _TABLES[2, content[at + 5]]
            ^ _TABLES[1, content[at + 6]]
            ^ _TABLES[0, content[at + 7]]
        )
    for at in range(whole, len(content)):
        value = _TABLES[0, (value ^ content[at]) & 255] ^ value >> 8
    return int(value ^ _ALL_ONES)
