"""Rules that the linters do not know: numba's flags, what kernels may see."""

import ast

from tests.core.architecture.source import dotted, functions, imports, modules

COMPILERS = {"njit", "jit", "vectorize", "guvectorize", "jitclass", "cfunc", "stencil", "prange", "generated_jit"}


def kernels():
    return {name: tree for name, tree in modules().items() if name.startswith("kernels/")}


def keywords(tree):
    return [node for node in ast.walk(tree) if isinstance(node, ast.keyword)]


def test_fast_math_and_parallel_sums_are_off_everywhere():
    violations = [
        f"{name}:{keyword.value.lineno} {keyword.arg}"
        for name, tree in modules().items()
        for keyword in keywords(tree)
        if keyword.arg in ("fastmath", "parallel")
        and not (isinstance(keyword.value, ast.Constant) and keyword.value.value is False)
    ]
    assert violations == []


def test_numba_compiles_through_kernel_jit_only():
    violations = {
        name: compilers
        for name, tree in modules().items()
        if name != "numerics/jit.py"
        and (
            compilers := {i for i in imports(tree) if i.startswith("numba.") and i.split(".")[-1] in COMPILERS}
            | {d for node in ast.walk(tree) if (d := dotted(node)) in {f"numba.{c}" for c in COMPILERS}}
        )
    }
    assert violations == {}


def test_kernels_import_only_numpy_numba_math_and_numerics():
    allowed = ("numpy", "numba", "math", "typing", "collections", "mavfi.numerics", "mavfi.kernels")
    violations = {
        f"{name}: {imported}"
        for name, tree in kernels().items()
        for imported in imports(tree)
        if not any(imported == a or imported.startswith(f"{a}.") for a in allowed)
    }
    assert violations == set()


def test_kernels_carry_their_randomness_in_their_memory():
    violations = [
        f"{name}:{node.lineno}"
        for name, tree in kernels().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and dotted(node).startswith(("np.random", "numpy.random", "random."))
    ]
    assert violations == []


ROUNDED_BY_CPU = {
    *("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "arcsin", "arccos", "arctan", "arctan2", "sinh", "cosh"),
    *("tanh", "exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "pow", "power", "cbrt", "hypot"),
    *("dot", "matmul", "vdot", "inner", "einsum", "solve", "inv", "svd", "eigh", "standard_normal", "normal"),
}
"""Functions of `math`, NumPy, its BLAS and its generators that give other bits on other processors."""
DECIDE_BITS = (
    "numerics/",
    "kernels/",
    "pipeline/",
    "sim/",
    "detectors/",
    "flight/",
    "extras/bench/",
    "extras/airsim/grounded.py",
    "extras/shared/",
    "record.py",
    "outcomes.py",
)
OUTWARD = ("extras/shared/frames.py",)
"""Frames of other programs: no flight of ours passes through these."""


def test_what_decides_bits_uses_no_function_that_differs_from_processor_to_processor():
    violations = [
        f"{name}:{node.lineno} {dotted(node)}"
        for name, tree in modules().items()
        if name.startswith(DECIDE_BITS) and name not in OUTWARD
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and node.attr in ROUNDED_BY_CPU
        and dotted(node).startswith(("math.", "np.", "stream.", "random.", "self._random"))
    ]
    assert violations == []


def test_compiled_powers_are_those_of_integers():
    """These are multiplications; others are the C library's."""
    violations = [
        f"{name}:{node.lineno}"
        for name, tree in modules().items()
        for function in functions(tree)
        if "kernel_jit" in map(dotted, function.decorator_list)
        for node in ast.walk(function)
        if isinstance(node, ast.BinOp)
        and isinstance(node.op, ast.Pow)
        and not (isinstance(node.right, ast.Constant) and isinstance(node.right.value, int))
    ]
    assert violations == []


def test_flights_do_without_blas():
    """Its libraries round differently on each generation of CPUs; `numerics.vectors` adds in a fixed order."""
    homes = ("kernels/", "pipeline/", "sim/", "numerics/", "detectors/", "flight/")
    products = ("dot", "vdot", "inner", "matmul", "einsum", "tensordot")

    def is_product(node: ast.AST) -> bool:
        if isinstance(node, ast.BinOp):
            return isinstance(node.op, ast.MatMult)
        if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
            return False
        along_an_axis = any(keyword.arg == "axis" for keyword in node.keywords)
        return node.func.attr in products or (ast.unparse(node.func).startswith("np.linalg.") and not along_an_axis)

    violations = [
        f"{name}:{node.lineno}"
        for name, tree in modules().items()
        for node in ast.walk(tree)
        if name.startswith(homes) and is_product(node)
    ]
    assert violations == []
