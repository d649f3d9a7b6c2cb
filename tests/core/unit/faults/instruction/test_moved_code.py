"""Code that is moved, renamed, commented and reformatted: no digest moves, and source lines are the new ones."""

import importlib
import sys

import numba
import pytest

from mavfi.campaign.plan import CompletedRun, RunSpec
from mavfi.campaign.store import Store
from mavfi.ir.injection.build import cached_build
from mavfi.ir.sources import cached_shape
from mavfi.levels.instruction import count, draw, run_forked
from mavfi.levels.instruction.fault import InstructionFault
from mavfi.record import End, FlightRecord

FLOAT = (numba.float64,)
HELPERS = """
from mavfi.numerics.jit import kernel_jit

@kernel_jit
def scaled(x):
    if x < 0.0:
        raise ValueError("below zero")
    return x * 3.0 + 1.0
"""
KERNEL = """
import math

from {package}.{helpers} import scaled
from mavfi.numerics.jit import kernel_jit

@kernel_jit
def track(x):
    total = 0.5
    for step in range(7):
        total = total * 0.9 + scaled(x + step)
    return math.sqrt(total)
"""


def edited(text):
    """The text with a docstring of the module, comments, other names of variables, and other layout."""
    text = '"""A module.\n\nWith a docstring."""\n' + text
    text = text.replace("@kernel_jit", "# A comment.\n\n\n@kernel_jit")
    text = text.replace(
        "total * 0.9 + scaled(x + step)",
        "(\n            total * 0.9  # less\n            + scaled(x + step)\n        )",
    )
    text = text.replace("return x * 3.0 + 1.0", "# Another one.\n    return (x * 3.0) + 1.0")
    return text.replace("total", "result")


def kernel_of(folder, package, helpers, kernel, change):
    """The kernel in a package with a module of helpers and one with the kernel."""
    (folder / package).mkdir()
    (folder / package / "__init__.py").touch()
    texts = {helpers: HELPERS, kernel: KERNEL.format(package=package, helpers=helpers)}
    for name, text in texts.items():
        (folder / package / f"{name}.py").write_text(change(text), encoding="utf-8")
    return importlib.import_module(f"{package}.{kernel}").track


@pytest.fixture(scope="module")
def kernels(tmp_path_factory):
    """A kernel before and after."""
    folder = tmp_path_factory.mktemp("moved")
    sys.path.insert(0, str(folder))
    yield (
        kernel_of(folder, "before", "helpers", "kernel", lambda text: text),
        kernel_of(folder, "a_longer_name", "arithmetic", "of_the_pipeline", edited),
    )
    sys.path.remove(str(folder))


def records_of(kernel):
    """Records of a golden run, which counts lines, and of runs with a fault each, as in a campaign."""
    table = cached_build(kernel, FLOAT).table
    lines = sorted({(site.file, site.line) for block in table.blocks for site in block})
    counted = {"instructions": count(kernel, 2.0), "calls": 1, "lines": [[file, line, 7] for file, line in lines]}
    records = [(None, FlightRecord(End.FLOWN, "success", counts={"pid": counted}))]
    for drawn in draw(kernel, 8, 2.0, seed=4):
        fault = InstructionFault(
            "",
            drawn.ir_sha256,
            drawn.index,
            bits=drawn.bits,
            budget=drawn.budget,
            value_class=drawn.value_class,
            stratum=drawn.stratum,
            kernel="pid",
            entry="track_pid",
        )
        records.append(
            (fault, FlightRecord(End.FLOWN, "success", injections=(run_forked(kernel, fault, 2.0).injection,)))
        )
    return records


def digest_of(records, directory):
    with Store.create(directory, {"campaign": "a campaign"}) as store:
        specs = [
            RunSpec(
                "injected" if fault else "golden",
                "fi",
                "sparse",
                7,
                "a mission",
                index=number,
                fault=fault,
                position=number,
            )
            for number, (fault, _) in enumerate(records)
        ]
        store.plan([spec.row() for spec in specs])
        for spec, (_, record) in zip(specs, records, strict=True):
            store.write([CompletedRun.of(spec.run_id, record)])
        return store.digest()


@pytest.mark.slow
def test_code_that_is_moved_renamed_commented_and_reformatted_has_the_same_digests(kernels, tmp_path):
    shapes = [cached_shape(kernel, FLOAT) for kernel in kernels]
    assert shapes[0] == shapes[1]
    assert [cached_build(kernel, FLOAT).ir_sha256 for kernel in kernels] == [shapes[0][0]] * 2
    before, after = (records_of(kernel) for kernel in kernels)
    assert digest_of(before, tmp_path / "before") == digest_of(after, tmp_path / "after")
    lines = [
        [(record.injections[0].file, record.injections[0].line) for _, record in records[1:]]
        for records in (before, after)
    ]
    assert {file for file, _ in lines[0]} == {"before/kernel.py", "before/helpers.py"}
    assert {file for file, _ in lines[1]} == {"a_longer_name/of_the_pipeline.py", "a_longer_name/arithmetic.py"}
    assert not {line for _, line in lines[0]} & {line for _, line in lines[1]}
