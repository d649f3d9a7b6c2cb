"""Random one-bit corruptions of every kernel's recorded inputs and memory, and of every detector's memory, with bounds
checked and passes counted.

    python -m tests.nightly.storm        (N=100000 ONLY=planner)

No step or check may raise, access out of bounds, or need more loop passes than its budget.  That an access out of
bounds is found, and that an endless loop is stopped, is proved first.
"""

import os
import sys
import tempfile
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
    """Prove that what is looked for would be found, in kernels that are compiled after `counting.install`."""
    import numpy as np

    from mavfi.numerics import jit

    def read_at(values, index):
        return values[index]

    def turn_for_ever(step):
        total = 0.0
        while total >= 0.0:
            total += step
        return total

    for function, arguments, expected in (
        (read_at, (np.zeros(3), 5), IndexError),
        (turn_for_ever, (1.0,), OverflowError),
    ):
        try:
            jit.kernel_jit(function)(*arguments)
        except expected:
            continue
        raise SystemExit(f"{function.__name__}: was not noticed")


def storm(trials, only=""):
    """Play tapes; returns what went wrong, and by kernel the most passes and the number of trials."""
    import numpy as np

    from tests.nightly.counting import passes
    from tests.nightly.tapes import record

    passes()
    tapes = record(recorders=[lambda state, time_us: passes()])
    names = sorted({tape.name for tape in tapes if only in ("", tape.name)})
    by_name = {name: [tape for tape in tapes if tape.name == name] for name in names}
    random = np.random.default_rng(1)
    wrong, most, count = [], dict.fromkeys(names, (0, "")), Counter()
    for trial in range(trials):
        name = names[trial % len(names)]
        tape = by_name[name][int(random.integers(len(by_name[name])))]
        label = ""
        passes()
        try:
            with np.errstate(all="ignore"):
                for item in tape.play(random):
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
        if (trial + 1) % 5000 == 0:
            say(f"{trial + 1}, {len(wrong)} findings")
    return wrong, most, count


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
        wrong, most, count = storm(int(os.environ.get("N", "100000")), os.environ.get("ONLY", ""))
    for name, trials in count.items():
        passes, label = most[name]
        say(f"{name:16s} {trials:6d} corruptions, at most {passes} of {BUDGETS[name]} passes ({label})")
    for line in wrong[:50]:
        say(line)
    say(f"{sum(count.values())} corruptions, {len(wrong)} findings")
    raise SystemExit(1 if wrong else 0)


def say(text):
    """One line, at once."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
