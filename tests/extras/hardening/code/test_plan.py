"""Plans: compact text of sites, identity, and one line for what is wrong."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavfi.errors import BadInputError
from mavfi.extras.hardening.plan import (
    FunctionPlan,
    ModuleSite,
    ProtectionPlan,
    check_code,
    load_plan,
    save_plan,
)

DIGEST = "ab" * 32


def of(**more):
    return FunctionPlan(**{"kernel": "pid", "function": "m.f", "signature": "float64", "ir_sha256": DIGEST, **more})


@given(st.sets(st.tuples(st.integers(0, 3), st.integers(0, 20), st.integers(0, 30)), max_size=40))
def test_a_plan_survives_its_file(tmp_path_factory, sites):
    path = tmp_path_factory.mktemp("plans") / "plan.yaml"
    plan = ProtectionPlan(functions=(of(sites=tuple(sites), time=1.16, predicted=0.9),))
    save_plan(plan, path)
    assert load_plan(path) == plan
    assert load_plan(path).functions[0].sites == tuple(sorted(ModuleSite(*site) for site in sites))


def test_sites_are_written_as_ranges_by_block(tmp_path):
    save_plan(
        ProtectionPlan(functions=(of(sites=((0, 2, 1), (0, 0, 0), (0, 0, 1), (0, 0, 2), (0, 0, 5), (1, 7, 3))),)),
        tmp_path / "p.yaml",
    )
    assert "'0': 0:0-2,5 2:1" in (tmp_path / "p.yaml").read_text()


PROTECTED = of(sites=((0, 0, 1),))


@pytest.mark.parametrize(
    "functions",
    [
        (of(sites=((0, 0, 1),), lines=("m.py:1",)),),
        (of(sites=((0, 0, 1),), predicted=0.9), of(function="m.g", kind="none")),
    ],
)
def test_neither_lines_nor_predictions_identify_a_plan(functions, tmp_path):
    plan = ProtectionPlan(functions=functions, budget=0.1)
    assert plan.bare == ProtectionPlan(functions=(PROTECTED,)).bare
    save_plan(plan, tmp_path / "p.yaml")
    assert load_plan(tmp_path / "p.yaml") == plan


@pytest.mark.parametrize("change", [{"sites": ((0, 0, 2),)}, {"time": 1.5}, {"function": "m.g"}])
def test_what_a_flight_depends_on_identifies_a_plan(change):
    changed = ProtectionPlan(functions=(of(**{"sites": ((0, 0, 1),), **change}),))
    assert changed.bare != ProtectionPlan(functions=(PROTECTED,)).bare


@pytest.mark.parametrize("key", ["studied", "certified"])
def test_a_plan_of_an_earlier_version_says_how_to_make_it_again(key, tmp_path):
    path = tmp_path / "plan.yaml"
    path.write_text(f"{key}: 1\nfunctions: []\n")
    with pytest.raises(BadInputError, match=f"key '{key}': dropped; make the plan again with mavfi harden"):
        load_plan(path)


def test_the_time_of_a_kernel_weights_its_functions_by_their_shares():
    functions = of(time=1.2, share=0.75), of(function="m.g", time=1.8, share=0.05), of(kernel="octomap", function="m.h")
    plan = ProtectionPlan(functions=functions)
    assert plan.time_of("pid") == pytest.approx(1 + 0.75 * 0.2 + 0.05 * 0.8) and plan.time_of("rrt") == 1.0
    old = ProtectionPlan(functions=(of(time=1.2, share=0.75), of(function="m.g", time=1.8)))
    assert old.time_of("pid") == 1.8, "the largest, if a share is not known"
    assert ProtectionPlan(functions=(of(kind="none", time=1.5),)).bare.time_of("pid") == 1.5, (
        "unprotected, its time is charged"
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sites": {0: "0:0-3 x"}}, "'x': not understood; allowed: block:offsets, e.g. 2:0-3,5"),
        ({"sites": {0: "0:3-1"}}, "'0:3-1': allowed: ascending numbers up to 1,000,000"),
        ({"sites": {"a": 1}}, "allowed: e.g. {0: '0:0-3,5 2:1'}"),
        ({"sites": {0: "0:1"}, "kind": "none"}, "kind 'none': 1 sites; allowed: sites with kind duplicate only"),
        ({"kind": "trap"}, "key 'functions.0.kind': 'trap': not known"),
        ({"ir_sha256": "abc"}, "key 'functions.0.ir_sha256': 'abc'"),
        ({"colour": 1}, "unknown key 'functions.0.colour'"),
    ],
)
def test_a_bad_plan_is_refused_in_one_line(tmp_path, change, message):
    import yaml

    entry = {"kernel": "pid", "function": "m.f", "signature": "float64", "ir_sha256": DIGEST, **change}
    path = tmp_path / "plan.yaml"
    path.write_text(yaml.safe_dump({"functions": [entry]}))
    with pytest.raises(BadInputError) as error:
        load_plan(path)
    assert message in str(error.value) and str(error.value).startswith(str(path)) and "\n" not in str(error.value)


def test_a_function_is_planned_once_for_a_signature():
    with pytest.raises(ValueError, match="planned twice"):
        ProtectionPlan(functions=(of(), of(kind="none")))


def test_a_plan_for_other_code_is_refused_in_one_line():
    check_code(of(sites=((0, 1, 2),)), DIGEST, [[0, 3]])
    with pytest.raises(
        BadInputError, match=r"protection of m\.f: planned for IR abababababab, this is cdcdcdcdcdcd: [^\n]*$"
    ):
        check_code(of(), "cd" * 32, [])


@pytest.mark.parametrize("site", [(1, 0, 0), (0, 2, 0), (0, 1, 3)])
def test_a_site_that_does_not_exist_is_refused_in_one_line(site):
    text = rf"protection of m\.f: site {site[1]}:{site[2]} of function {site[0]}: not in its code; [^\n]*$"
    with pytest.raises(BadInputError, match=text):
        check_code(of(sites=(site,)), DIGEST, [[0, 3]])
