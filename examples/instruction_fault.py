"""Flip one bit of one executed instruction of a kernel of one's own.

python examples/instruction_fault.py
"""

import numpy as np

from mavfi.levels import instruction
from mavfi.numerics.jit import kernel_jit


@kernel_jit
def mean_square(values: np.ndarray) -> float:
    total = 0.0
    for value in values:
        total += value * value
    return total / len(values)


def main() -> None:
    values = np.linspace(0.0, 1.0, 100)
    print(f"{instruction.count(mean_square, values)} dynamic instructions")
    for fault in instruction.draw(mean_square, 8, values, seed=1):
        outcome = instruction.run_forked(mean_square, fault, values)
        injection, details = outcome.injection, outcome.injection.details
        where = f"{injection.file}:{injection.line} {details['opcode']} {details['type']}"
        print(f"{outcome.how:9} index {fault.index}, bit {fault.bit}: {where}: {injection.before} -> {injection.after}")


if __name__ == "__main__":
    main()
