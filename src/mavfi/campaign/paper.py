"""The paper's own figures, to stand beside ours.

Source: Hsiao, Wan, Jia, Ghosal, Mahmoud, Raychowdhury, Brooks, Wei, Reddi, "MAVFI: An End-to-End Fault Analysis
Framework with Anomaly Detection and Recovery for Micro Aerial Vehicles".  Its faults are at the instruction level
(100 per stage); ours are at the state level (`NOTE`) or, like the paper's, at the instruction level
(`INSTRUCTION_NOTE`), and every table says which.
"""

SUCCESS: dict[str, dict[str, float]] = {
    "factory": {"golden": 1.000, "fi": 0.917, "dr_gaussian": 0.987, "dr_autoencoder": 0.993},
    "farm": {"golden": 1.000, "fi": 0.973, "dr_gaussian": 0.993, "dr_autoencoder": 1.000},
    "sparse": {"golden": 0.950, "fi": 0.883, "dr_gaussian": 0.943, "dr_autoencoder": 0.950},
    "dense": {"golden": 0.850, "fi": 0.753, "dr_gaussian": 0.830, "dr_autoencoder": 0.847},
}
"""Table I: flight success rate by environment and setting."""

WORST_TIME_INCREASE: dict[str, float] = {"factory": 0.738, "farm": 0.742, "sparse": 0.626, "dense": 0.933}
"""Section VI-A: increase of the worst flight time with fault injection over the golden run's, successful flights."""

WORST_TIME_RECOVERED: dict[str, dict[str, float]] = {
    "factory": {"dr_gaussian": 0.564, "dr_autoencoder": 0.642},
    "farm": {"dr_gaussian": 0.635, "dr_autoencoder": 0.684},
    "sparse": {"dr_gaussian": 0.490, "dr_autoencoder": 0.578},
    "dense": {"dr_gaussian": 0.587, "dr_autoencoder": 0.730},
}
"""Section VI-A: "recovered by", percentage points of the increase."""

RECOVERY: dict[str, dict[str, float]] = {
    environment: {
        method: (rates[method] - rates["fi"]) / (rates["golden"] - rates["fi"])
        for method in ("dr_gaussian", "dr_autoencoder")
    }
    for environment, rates in SUCCESS.items()
}
"""Derived from Table I as (method - fi) / (golden - fi); the paper quotes up to 89.6 % and 100 %."""

RECOMPUTE_OVERHEAD: dict[str, dict[str, dict[str, float]]] = {
    "factory": {"dr_gaussian": {"perception": 0.009603, "planning": 0.010199, "control": 1e-6}},
    "farm": {"dr_gaussian": {"perception": 0.010902, "planning": 0.007801, "control": 1e-6}},
    "sparse": {"dr_gaussian": {"perception": 0.009788, "planning": 0.009421, "control": 1e-6}},
    "dense": {"dr_gaussian": {"perception": 0.011932, "planning": 0.010279, "control": 1e-6}},
}
"""Table II, columns RECOV: recomputation / compute time; values below 0.0001 % are given as that bound."""

DETECTION_OVERHEAD: dict[str, dict[str, float]] = {
    "dr_autoencoder": {"factory": 4.2e-5, "farm": 3.7e-5, "sparse": 4.7e-5, "dense": 6.2e-5},
}
"""Table II, row PPC, columns DET: detection / compute time."""

KERNELS: dict[str, str] = {
    "point_cloud": "little to negligible impact",
    "octomap": "little to negligible impact",
    "collision_check": "critical within perception",
    "rrt": "flight time widely spread",
    "rrt_connect": "flight time widely spread",
    "rrt_star": "flight time widely spread",
    "pid": "flight time widely spread",
}
"""Section III-B, what the text says of Fig. 3 (Sparse, 100 runs per kernel, instruction level); it gives no rates."""

KERNELS_WORST_TIME, KERNELS_SUCCESS_LOSS = 0.573, 0.08
"""Section III-B: flight time of planning and control kernels "by up to", and loss of success rate "by up to"."""

NOTE = "state-level variant of the paper's Table I, which is at instruction level"
INSTRUCTION_NOTE = "instruction level: the paper's Table I"
