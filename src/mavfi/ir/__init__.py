"""LLVM IR of compiled kernels: reader, printer, translation into machine code, and its cache on disk."""
