"""The digest of the fault space: the same in every process, whatever its hashes, cache and order of compilation."""

import json
import os
import subprocess
import sys

import numba
import pytest

from mavfi.ir import build as building
from mavfi.ir.forked import ChildEnd
from mavfi.ir.injection.build import build
from mavfi.ir.injection.instrument import instrument
from mavfi.ir.module import BuildError, digest_of_text
from mavfi.numerics.jit import kernel_jit, uncached_copy
from tests.core.unit.kernels.cases import CASES

COMPILE = """
import json, sys
import numba
from mavfi.ir.injection.instrument import instrument
from mavfi.ir.build import source_of
from tests.core.unit.kernels.cases import CASES

digests = {}
for name in sys.argv[1:]:
    case = CASES[name]
    signature = tuple(numba.typeof(argument) for argument in case.arguments())
    digests[name] = instrument(source_of(case.function, signature).text, name).ir_sha256
print(json.dumps(digests))
"""
TWO = ("track", "back_project")
OLDEST = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}


def ir_digests(names, cache, variables):
    """Digests of the fault spaces of kernels, compiled in this order in a process with an empty cache."""
    environment = os.environ | {
        "XDG_CACHE_HOME": str(cache),
        "PYTHONPATH": os.pathsep.join([".", *sys.path]),
        **variables,
    }
    environment.pop("NUMBA_CACHE_DIR", None)
    done = subprocess.run(
        [sys.executable, "-c", COMPILE, *names], env=environment, capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout)


@kernel_jit
def scolding(x):
    """A kernel that makes a text while it runs."""
    text = "a number below zero: "
    if x < 0.0:
        text = text + "far "
    return x * len(text)


def text_of(kernel):
    copy = uncached_copy(kernel)
    copy.compile((numba.float64,))
    return copy.inspect_llvm((numba.float64,))


@pytest.mark.slow
def test_the_digest_does_not_depend_on_hashes_of_texts():
    """Numba names constant texts by their hash, which is another one in each process, and may be negative."""
    text = text_of(scolding)
    names = [word for word in text.replace(",", " ").split() if word.startswith("@.bytes.")]
    assert names
    digests = set()
    for number in ("123456789012345678", "-123456789012345678", "-8812345678901234567"):
        other = text.replace(names[0], f"@.bytes.{number}")
        assert other != text
        digests.add(instrument(other, "scolding").ir_sha256)
    assert digests == {instrument(text, "scolding").ir_sha256}
    assert instrument(text.replace("fmul double", "fadd double"), "scolding").ir_sha256 not in digests


@pytest.mark.slow
def test_a_kernel_is_prepared_for_any_cpu_where_nothing_was_compiled_before(monkeypatch, tmp_path):
    """What LLVM inlines depends on what a process did before (compiled a callee, or loaded it), vectors on the CPU."""

    in_fork = ChildEnd("exception", detail="prepared in a fork of this process")
    monkeypatch.setattr(building, "run_in_child", lambda *_: in_fork)
    case = CASES["time_to_collision"]
    signature = tuple(numba.typeof(argument) for argument in case.arguments())
    built = build(case.function, signature)
    assert built.owned and built.ir_sha256 == ir_digests(["time_to_collision"], tmp_path, OLDEST)["time_to_collision"]

    @kernel_jit
    def hidden(x):
        return 2.0 * x

    with pytest.raises(BuildError, match="prepared in a fork"):
        build(hidden, (numba.float64,))  # another process would not find it


def test_a_kernel_that_another_process_would_not_find_is_prepared_in_a_fork():
    @kernel_jit
    def twice(x):
        return doubled(x) + doubled(x + 1.0)

    assert build(twice, (numba.float64,)).table.sizes()


@kernel_jit
def doubled(x):
    return 2.0 * x


@pytest.mark.slow
@pytest.mark.long
def test_fresh_processes_with_empty_caches_agree_in_any_order(tmp_path):
    digests = [
        ir_digests(order, tmp_path / str(number), {"PYTHONHASHSEED": str(number)})
        for number, order in enumerate((TWO, TWO[::-1]))
    ]
    assert set(digests[0]) == set(TWO)
    assert digests[0] == digests[1]


def test_the_digest_tells_one_callee_from_another():
    twice = "call void @_ZN1fEd()\ncall void @_ZN1fEd()"
    assert digest_of_text(twice) != digest_of_text("call void @_ZN1fEd()\ncall void @_ZN1gEd()")
    assert digest_of_text("call double @sin()") != digest_of_text("call double @cos()")
