"""Elementary functions, bit-identical on every processor, with errors below 1 ulp, but for `quick_tanh`.

The rounding of libm's functions depends on the CPU (with or without FMA).  These use only additions, multiplications,
divisions and square roots, in a fixed order, each rounded as in IEEE 754; LLVM does not contract them.  Sources:
fdlibm (Sun Microsystems, 1993) for polynomials and breakpoints; Muller et al., Handbook of Floating-Point Arithmetic
(2018), chapter 4, for error-free sums and products.
"""

from mavfi.numerics.elementary.angles import cos, sin, tan
from mavfi.numerics.elementary.arcs import acos, asin, atan2
from mavfi.numerics.elementary.exponentials import cbrt, exp, log, quick_tanh, tanh

__all__ = ["acos", "asin", "atan2", "cbrt", "cos", "exp", "log", "quick_tanh", "sin", "tan", "tanh"]
