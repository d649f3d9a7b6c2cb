"""Which values count as addresses, control, floating point and integer data, on IR written by hand."""

import pytest

from mavfi.errors import BadInputError
from mavfi.ir.injection.table import FORM, make_table, parse_selection, short_path
from mavfi.ir.module import parts, width
from mavfi.ir.parser import parse_module

TEXT = """
define i64 @kernel(ptr %p, ptr %q, double %x, i64 %n) {
entry:
  %found = alloca i64, align 8
  %scaled = fmul double %x, 2.000000e+00
  %cell = fptosi double %scaled to i64
  %place = getelementptr i64, ptr %p, i64 %cell
  %index = load i64, ptr %place, align 8
  %again = getelementptr i64, ptr %q, i64 %index
  %data = load i64, ptr %again, align 8
  %more = add nuw nsw i64 %data, %n
  %inside = icmp samesign ult i64 %more, 100
  %number = fadd double %x, 1.000000e+00
  %large = fcmp ogt double %number, 3.000000e+00
  %both = and i1 %inside, %large
  %other = load i64, ptr %q, align 8
  %chosen = select i1 %both, i64 %other, i64 7
  %shift = shl i64 %n, 3
  %status = call i32 @callee(ptr nonnull %found, ptr nonnull %q, i64 %shift, i64 %chosen, i64 %n)
  %best = load i64, ptr %found, align 8
  %spot = getelementptr double, ptr %p, i64 %best
  %last = load double, ptr %spot, align 8
  %wrapped = call { i64, i1 } @llvm.uadd.with.overflow.i64(i64 %n, i64 1)
  %sum = extractvalue { i64, i1 } %wrapped, 0
  br label %end

end:
  ret i64 %sum
}

declare { i64, i1 } @llvm.uadd.with.overflow.i64(i64, i64) #0

define linkonce_odr i32 @callee(ptr noalias %result, ptr %q, i64 %offset, i64 %plain, i64 %start) local_unnamed_addr {
  %place = getelementptr i8, ptr %q, i64 %offset
  store i64 %plain, ptr %place, align 8
  %best = add i64 %start, 1
  store i64 %best, ptr %result, align 8
  ret i32 0
}

attributes #0 = { nounwind }
"""
CLASSES = [
    ("fmul", "address"),
    ("fptosi", "address"),
    ("getelementptr", "address"),
    ("load", "address"),
    ("getelementptr", "address"),
    ("load", "control"),
    ("add", "control"),
    ("icmp", "control"),
    ("fadd", "floating_point"),
    ("fcmp", "control"),
    ("and", "control"),
    ("load", "integer"),
    ("select", "integer"),
    ("shl", "address"),  # through the parameter of the callee
    ("call", "integer"),
    ("load", "address"),
    ("getelementptr", "address"),
    ("load", "floating_point"),
    ("call", "control"),
    ("extractvalue", "control"),  # what is returned is a status
    ("getelementptr", "address"),
    ("add", "address"),  # through memory: the caller loads it as an index
]


@pytest.fixture(scope="module")
def module():
    return parse_module(TEXT, "kernel")


@pytest.fixture(scope="module")
def sites(module):
    return [site for block in make_table(module).blocks for site in block]


def test_classes(sites):
    assert [(site.opcode, site.value_class) for site in sites] == CLASSES


def test_widths(sites):
    assert {site.opcode: site.width for site in sites if site.opcode in ("icmp", "fadd", "call")} == {
        "icmp": 1,
        "fadd": 64,
        "call": 65,
    }
    assert [site.width for site in sites if site.opcode == "call"] == [32, 65]
    assert width("<16 x i1>") == 16
    assert width("[2 x { i8, <4 x ptr> }]") == 2 * (8 + 256)
    assert parts("{ i64, { i1, double } }") == ["i64", "{ i1, double }"]


def test_promises_are_left_out(module):
    text = "\n".join([*module.preamble, *(function.text() for function in module.functions)])
    for word in ("nuw", "nsw", "samesign", "nonnull", "noalias", "#0"):
        assert word not in text
    assert "align 8" in text and "linkonce_odr" in text


@pytest.mark.parametrize(
    ("which", "count"),
    [
        ("all", 22),
        ("data", 5),
        ("address", 10),
        ("control", 7),
        ("integer", 3),
        ("floating_point", 3),
        ("opcode:load", 5),
        ("opcode:fdiv", 0),
    ],
)
def test_selections(sites, which, count):
    assert sum(site in parse_selection(which) for site in sites) == count


def test_a_selection_of_lines_looks_at_whole_chains():
    assert parse_selection("line:pid.py:40-60").last == 60
    assert parse_selection("line:pid.py:40").last == 40
    with pytest.raises(BadInputError, match="allowed: all"):
        parse_selection("lines:pid.py:40")
    assert "line:FILE" in FORM


def test_paths_do_not_name_the_machine(monkeypatch):
    monkeypatch.setattr("sys.path", ["/a", "/a/b/", ""])
    assert short_path("/a/b/c/d.py") == "c/d.py"
    assert short_path("/z/d.py") == "/z/d.py"
