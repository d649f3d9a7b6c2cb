"""The cache of instrumented machine code: hits, misses, and entries that are no longer valid."""

import importlib.util
import sys

import numba
import pytest

from mavfi.ir import sources as object_cache
from mavfi.ir.injection import build
from mavfi.ir.injection.build import cached_build
from mavfi.ir.module import BuildError
from tests.core.unit.faults.instruction.kernels import closure

FLOAT = (numba.float64,)
SOURCE = """
from mavfi.numerics.jit import kernel_jit

@kernel_jit
def callee(x):
    return x * {factor}

@kernel_jit
def kernel(x):
    return callee(x) + 1.0
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(object_cache, "code_folder", lambda: tmp_path)
    return tmp_path / "instruction"


@pytest.fixture
def builds(monkeypatch):
    """Names of the kernels that were built."""
    names = []

    plain = build.build

    def counting(kernel, signature, rewrite=None):
        names.append(kernel.py_func.__name__)
        return plain(kernel, signature, rewrite)

    monkeypatch.setattr(build, "build", counting)
    return names


def load(path, factor):
    path.write_text(SOURCE.format(factor=factor), encoding="utf-8")
    return module_at(path, path.stem).kernel


def module_at(path, name):
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_a_second_look_builds_nothing(folder, builds, tmp_path):
    kernel = load(tmp_path / "cached_a.py", 2.0)
    first, second = cached_build(kernel, FLOAT), cached_build(kernel, FLOAT)
    assert builds == ["kernel"]
    assert (first.code, first.table, first.ir_sha256) == (second.code, second.table, second.ir_sha256)
    assert [path.suffix for path in folder.iterdir()] == [".bin"]
    cached_build(kernel, (numba.float32,))
    assert builds == ["kernel", "kernel"]


@pytest.mark.slow
def test_an_edited_file_makes_an_entry_void_even_if_the_loaded_code_is_the_same(folder, builds, tmp_path):
    kernel = load(tmp_path / "cached_c.py", 2.0)
    cached_build(kernel, FLOAT)
    (tmp_path / "cached_c.py").write_text(SOURCE.format(factor=2.0) + "\n# a remark\n", encoding="utf-8")
    cached_build(kernel, FLOAT)
    assert builds == ["kernel", "kernel"]


@pytest.mark.slow
def test_damaged_entries_are_built_again(folder, builds, tmp_path):
    kernel = load(tmp_path / "cached_d.py", 2.0)
    cached_build(kernel, FLOAT)
    entry = next(folder.iterdir())
    data = entry.read_bytes()
    for number, damaged in enumerate((b"", b"short", data[:-1] + bytes([data[-1] ^ 1])), start=2):
        entry.write_bytes(damaged)
        cached_build(kernel, FLOAT)
        assert builds == ["kernel"] * number
        assert entry.read_bytes()[:32] == data[:32]


def test_rewritten_code_depends_on_the_text_of_the_package_that_rewrites_it(folder, monkeypatch, tmp_path):
    kernel, built, names = closure(2.0), build.build(closure(2.0), FLOAT), []
    monkeypatch.setattr(build, "build", lambda *_: names.append("built") or built)
    for number, change in enumerate(("1", "2", "2")):
        path = tmp_path / f"package{number}" / "rewriting.py"
        path.parent.mkdir()
        path.write_text(f"class Rewriting:\n    key = b'one'\n    change = {change}\n", encoding="utf-8")
        cached_build(kernel, FLOAT, module_at(path, f"rewriting{number}").Rewriting())
    assert len(names) == 2


def test_a_compiler_that_dies_is_reported(monkeypatch):
    import os

    monkeypatch.setattr(build, "translate", lambda text: os.abort())
    with pytest.raises(BuildError, match="scaled: the compiler ended with SIGABRT"):
        build.build(closure(2.0), FLOAT)
