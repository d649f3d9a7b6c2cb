"""Random one-bit corruptions of every kernel's recorded inputs and memory, and of every detector's memory, with bounds
checked and passes counted.

    python -m tests.nightly.storm        (N=100000 ONLY=planner)

No step or check may raise, access out of bounds, or need more loop passes than its budget.  That an access out of
bounds is found, and that an endless loop is stopped, is proved first.
"""

import os
import sys
import tempfile
import time
from collections import Counter

BUDGETS = {
    "point_cloud": 50_000,
    "octomap": 20_000_000,
    "collision_check": 1_000_000,
    "planner": 100_000_000,
    "trajectory": 30_000_000,
    "waypoint": 100_000,
    "pid": 100,
    "state_estimation": 20_000,
    "acceptance": 50_000,
    "gaussian": 2_000,
    "autoencoder": 20_000,
    "physics_gate": 2_000,
}
"""Loop passes of one step, with the inputs that it received before it.

The trajectory's follows from its limits: 10,000 knots solved at 850 passes each, and a curve of 1,500 s looked up
six times, every 0.02 s, at 30 passes each.
"""


def canaries():
    """Prove that what is looked for would be found."""
    import numpy as np

    from tests.nightly import endless

    for function, arguments, expected in (
        (endless.read_at, (np.zeros(3), 5), IndexError),
        (endless.turn_for_ever, (1.0,), OverflowError),
    ):
        try:
            function(*arguments)
        except expected:
            continue
        raise SystemExit(f"{function.__name__}: was not noticed")


def storm(trials, only=""):
    """Play tapes; returns what went wrong, and by kernel the most passes, the longest time, the number of trials."""
    import numpy as np

    from tests.nightly.counting import passes
    from tests.nightly.tapes import play, record
    from tests.nightly.watching import Watched, play_watching, record_watching

    passes()
    tapes = [*record(recorders=[lambda state, time_us: passes()]), *record_watching()]
    names = sorted({tape.name for tape in tapes if only in ("", tape.name)})
    by_name = {name: [tape for tape in tapes if tape.name == name] for name in names}
    random = np.random.default_rng(1)
    wrong, most, slowest, count = [], dict.fromkeys(names, (0, "")), dict.fromkeys(names, (0.0, "")), Counter()
    start = time.perf_counter()
    for trial in range(trials):
        name = names[trial % len(names)]
        tape = by_name[name][int(random.integers(len(by_name[name])))]
        label, began = "", time.process_time()
        passes()
        try:
            with np.errstate(all="ignore"):
                for item in (play_watching if isinstance(tape, Watched) else play)(tape, random):
                    if isinstance(item, str):
                        label = item
                        continue
                    used = passes()
                    most[name] = max(most[name], (used, f"{tape.autopilot}, {label}"))
                    if used > BUDGETS[name]:
                        wrong.append(f"{name} ({tape.autopilot}), {label}: {used} passes")
        except Exception as error:  # noqa: BLE001 - whatever a kernel raises is a finding
            wrong.append(f"{name} ({tape.autopilot}), {label}: {type(error).__name__}: {error}")
        count[name] += 1
        slowest[name] = max(slowest[name], (time.process_time() - began, f"{tape.autopilot}, {label}"))
        if (trial + 1) % 5000 == 0:
            sys.stdout.write(f"{trial + 1} in {time.perf_counter() - start:.0f} s, {len(wrong)} findings\n")
            sys.stdout.flush()
    return wrong, most, slowest, count


def main():
    """Storm, tell, fail if something was found."""
    os.environ["NUMBA_BOUNDSCHECK"] = "1"
    with tempfile.TemporaryDirectory() as cache:  # compiled without bounds checks elsewhere
        os.environ["NUMBA_CACHE_DIR"] = cache
        from mavfi.plugins import allow_plugins
        from tests.nightly import counting

        allow_plugins()  # the generator of the world
        counting.install()
        canaries()
        wrong, most, slowest, count = storm(int(os.environ.get("N", "100000")), os.environ.get("ONLY", ""))
    for name, trials in count.items():
        passes, label = most[name]
        sys.stdout.write(f"{name:16s} {trials:6d} corruptions, at most {passes} of {BUDGETS[name]} passes ({label})\n")
        seconds, label = slowest[name]
        sys.stdout.write(f"{'':16s} longest {seconds:.2f} s ({label})\n")
    sys.stdout.write("\n".join(wrong[:50]) + ("\n" if wrong else ""))
    sys.stdout.write(f"{sum(count.values())} corruptions, {len(wrong)} findings\n")
    raise SystemExit(1 if wrong else 0)


if __name__ == "__main__":
    main()
