"""A summary as `campaign.hardening.summary` makes it."""


def rate(value, n=60, spread=0.05):
    if value is None:
        return {"n": 0, "rate": None, "low": None, "high": None, "successes": None}
    low, high = max(0.0, value - spread), min(1.0, value + spread)
    return {"n": n, "rate": value, "low": low, "high": high, "successes": round(n * value)}


def ways(best):
    """Coverage by way to choose; the minimum cut is the best."""
    factors = {"cut": 1.0, "line": 0.8, "opcode": 0.6, "random": 0.4}
    return [
        {"share": share, "p": {"line": 0.2, "opcode": 0.01, "random": 1e-9},
         "coverage": {way: rate(best * share * factor) for way, factor in factors.items()}}
        for share in (0.1, 0.25, 0.5, 0.75)
    ]  # fmt: skip


def function(kernel, entry, share, steps, chosen, file="mavfi/kernels/control/pid.py", first=60):
    rows = [
        {"fraction": i / 5, "instructions": 1 + i / 4, "time": time, "coverage": rate(value), "chosen": i == chosen}
        for i, (time, value) in enumerate(steps)
    ]
    time, value = steps[chosen]
    lines = [
        {"file": file, "line": first + 2 * i, "instructions": 0.04 * (i + 1), "sdc": 0.1 - 0.01 * i, "protected": i / 9}
        for i in range(10)
    ]
    return {
        "kernel": kernel, "function": f"mavfi.{entry}", "entry": entry, "signature": "f8", "calls": 1800,
        "instructions": 868_901, "injections": 400, "sdc": rate(0.45), "share": share, "time": time,
        "added": share * (time - 1), "coverage": rate(value), "sites": 310, "all_sites": 705, "steps": rows,
        "certified": None,
        "ways": ways(value or 1.0),
        "escapes": {"protected": 0.8, "beyond the budget": 0.15, "cannot repeat: call": 0.05}, "lines": lines,
    }  # fmt: skip


def summary():
    track = [(1.0, 0.0), (1.08, 0.3), (1.12, 0.55), (1.2, 0.8), (1.3, 0.9), (1.38, 0.97)]
    scan = [(1.0, 0.0), (1.2, 0.2), (1.5, 0.6), (1.8, 0.8), (2.2, 0.95), (2.4, 1.0)]
    functions = [
        function("pid", "track", 0.001, track, 5),
        function("octomap", "insert_scan", 0.77, scan, 1, "mavfi/kernels/perception/octomap.py", 56),
        function("collision_check", "apply_updates", 0.2, track, 0, "mavfi/kernels/perception/clearance.py", 84),
    ]
    return {
        "campaign": "hardening <small>", "ledger": "0123456789abcdef" * 4, "budget": 0.1, "spent": 0.099,
        "coverage": rate(0.46), "injections": 1200, "complete": True,
        "selected": [], "addresses": False,
        "kernels": [
            {"kernel": row["kernel"], "share": row["share"], "added": row["added"], "time": row["time"],
             "coverage": row["coverage"]}
            for row in functions
        ],
        "functions": functions,
        "harm": {"silent": rate(0.0, 253, 0.01), "dead": rate(0.08, 60), "dead_share": rate(0.16, 1200)},
    }  # fmt: skip
