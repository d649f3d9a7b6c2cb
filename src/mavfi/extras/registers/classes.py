"""Classes of registers, and functions of instructions, for tables."""


def class_of(register: str) -> str:
    """Class of a register, given its name in an instruction: FP, flags, stack, or general."""
    if register.startswith(("xmm", "ymm")):
        return "FP (XMM, YMM)"
    if register == "rflags":
        return "flags"
    if register in ("rsp", "esp", "rbp", "ebp"):
        return "stack (rsp, rbp)"
    return "general"


def function_of(symbol: str) -> str:
    """Name of a function, given "name.part.0+0x1c": without the distance, and without what the compiler has added."""
    return symbol.partition("+")[0].partition(".")[0] or "(no symbol)"
