"""What a report says around its tables: what was flown, and whether the null runs were the golden ones."""

from mavfi.reports import text
from mavfi.reports.tables import Analysis

_EACH = {"stage_balanced": "stage", "groups": "group"}


def each(analysis: Analysis) -> str:
    """What a number of faults is drawn for: a stage, a group or a kernel."""
    c = analysis["campaign"]
    return str(c["kernels"]["share"] if c["law"] == "kernels" else _EACH[c["law"]])


def null_line(analysis: Analysis) -> str:
    """Whether flights with an empty mask were the golden ones."""
    check = analysis["null_check"]
    if not check["n"]:
        return "Null runs: none flown."
    if check["passed"]:
        return f"Null runs: all {check['n']} flights with an empty mask have the digest of their golden twins."
    return f"Null runs: {len(check['differing'])} of {check['n']} DIFFER from their golden twins: " + ", ".join(
        check["differing"]
    )


def header(analysis: Analysis) -> list[str]:
    """What was flown, in lines."""
    c = analysis["campaign"]
    seeds = f"seeds {c['seeds'][0]} to {c['seeds'][1]}"
    shares = sorted(c["strata"].items(), reverse=True)
    strata = " : ".join(f"{text.population(name)} {share:g}" for name, share in shares)
    drawn = f"drawn {strata}, fields: {c['sites']}"
    if c["law"] == "kernels":
        drawn = f"instructions: {c['kernels']['which']}, model {c['kernels']['model']}"
        if c["kernels"].get("sampling") == "stratified":
            drawn += ", drawn by value class and source line"
    versions = sorted(c["versions"].items(), key=lambda item: item[0] != "mavfi")
    speed = "" if c["v_max"] is None else f" · {c['v_max']:g} m/s"
    lines = [
        f"campaign {c['name']} · stack {c['stack']} · {c['platform']} · {c['planner']}{speed}",
        f"{c['flights']} missions per environment ({seeds}), {c['faults']} faults per {each(analysis)}, {drawn}",
        f"{c['done']} of {c['total']} flights done · digest {c['digest'][:16]}…",
        " · ".join(f"{name} {version}" for name, version in versions),
    ]
    if c["detectors"]:
        arms = (
            f"{name} ({arm['profile']})"
            if name == arm["detector"]
            else f"{name} = {arm['detector']} ({arm['profile']})"
            for name, arm in sorted(c["detectors"].items())
        )
        lines.insert(2, f"detectors: {', '.join(arms)}; coupling inline; monitored set {c['monitored_set']}")
    if c["on_design_seeds"]:
        lines.append("Flown on design seeds: no figure for publication.")
    if c["done"] < c["total"]:
        lines.append("Not complete: what follows is of the flights that are done.")
    return lines
