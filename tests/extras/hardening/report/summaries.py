"""A summary as `mavfi.extras.hardening.summary` makes it."""

from mavfi.analysis.statistics import Rate
from mavfi.extras.hardening.summary import AdviceSummary, FunctionSummary, Harm, KernelSummary, LineSummary, StepSummary


def rate(value, n=60, spread=0.05):
    if value is None:
        return Rate(0, None, None, None)
    return Rate(n, value, max(0.0, value - spread), min(1.0, value + spread), round(n * value))


def function(kernel, entry, share, steps, chosen, file="mavfi/kernels/control/pid.py", first=60):
    time, value = steps[chosen]
    return FunctionSummary(
        kernel=kernel,
        function=f"mavfi.{entry}",
        entry=entry,
        signature="f8",
        calls=1800,
        recorded=24,
        missions=8,
        instructions=868_901,
        injections=400,
        sdc=rate(0.45),
        share=share,
        time=time,
        added=share * (time - 1),
        coverage=rate(value),
        certified=None,
        sites=310,
        all_sites=705,
        steps=tuple(
            StepSummary(i / 5, 1 + i / 4, time, rate(value), i == chosen) for i, (time, value) in enumerate(steps)
        ),
        escapes={"protected": 0.8, "beyond the budget": 0.15, "cannot repeat: call": 0.05},
        lines=tuple(LineSummary(file, first + 2 * i, 0.04 * (i + 1), 0.1 - 0.01 * i, i / 9) for i in range(10)),
        unseen_lines={},
    )


def summary():
    track = [(1.0, 0.0), (1.08, 0.3), (1.12, 0.55), (1.2, 0.8), (1.3, 0.9), (1.38, 0.97)]
    scan = [(1.0, 0.0), (1.2, 0.2), (1.5, 0.6), (1.8, 0.8), (2.2, 0.95), (2.4, 1.0)]
    functions = (
        function("pid", "track", 0.001, track, 5),
        function("octomap", "insert_scan", 0.77, scan, 1, "mavfi/kernels/perception/octomap.py", 56),
        function("collision_check", "apply_updates", 0.2, track, 0, "mavfi/kernels/perception/clearance.py", 84),
    )
    kernels = tuple(KernelSummary(row.kernel, row.share, row.added, row.time, row.coverage) for row in functions)
    return AdviceSummary(
        campaign="hardening <small>",
        ledger="0123456789abcdef" * 4,
        budget=0.1,
        spent=0.099,
        coverage=rate(0.46),
        injections=1200,
        complete=True,
        selected=(),
        addresses=False,
        kernels=kernels,
        functions=functions,
        harm=Harm(rate(0.0, 253, 0.01), rate(0.08, 60), rate(0.16, 1200)),
    )
