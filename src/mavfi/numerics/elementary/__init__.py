"""Elementary functions that give the same bits on every processor, to less than one unit in the last place.

The C library rounds sin, exp and their like differently with and without FMA, and so from CPU to CPU.  These use
additions, multiplications, divisions and square roots alone, in a fixed order, each rounded as IEEE 754 says; LLVM does
not contract them.  Sources: fdlibm (Sun Microsystems, 1993) for polynomials and breakpoints; Muller et al., Handbook of
Floating-Point Arithmetic (2018), chapter 4, for sums and products with their errors.
"""

from mavfi.numerics.elementary.angles import cos, sin, tan
from mavfi.numerics.elementary.arcs import acos, asin, atan2
from mavfi.numerics.elementary.exponentials import cbrt, exp, log, tanh

__all__ = ["acos", "asin", "atan2", "cbrt", "cos", "exp", "log", "sin", "tan", "tanh"]
