"""Protection of compiled kernels: which instructions are duplicated, and the transformation of their IR."""
