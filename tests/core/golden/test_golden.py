import json
import platform
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

from mavfi.flight.compose import resolve
from mavfi.flight.fly import fly
from mavfi.mission import MissionSpec

STORE = Path(__file__).with_name("digests.json")
FLIGHTS = [
    (environment, autopilot, seed)
    for environment in ("sparse", "dense", "factory", "farm")
    for autopilot in ("published", "hardened")
    for seed in (0, 1)
]
TAGS = {
    "machine": platform.machine(),
    "system": sys.platform,
    **{name: version(name) for name in ("numba", "llvmlite", "numpy", "mujoco-core")},
}


def stored():
    return json.loads(STORE.read_text(encoding="utf-8")) if STORE.is_file() else {"made_with": {}, "digests": {}}


@pytest.mark.slow
def test_the_flights_are_still_the_same(request):
    """One test for all flights, so that an update replaces the whole file."""
    update = request.config.getoption("--update-goldens")
    content = stored()
    if content["made_with"] != TAGS and not update:
        differences = {
            name: f"{content['made_with'].get(name)} -> {tag}"
            for name, tag in TAGS.items()
            if content["made_with"].get(name) != tag
        }
        pytest.skip(f"bits are promised for one set of versions only: {differences}")
    digests = {}
    for environment, autopilot, seed in FLIGHTS:
        log = fly(resolve(MissionSpec(environment=environment, seed=seed, autopilot=autopilot))).log
        digests[f"{environment} {autopilot} {seed}"] = f"{log.digest()} {log.status.label} {len(log.rows)}"
    if update:
        STORE.write_text(json.dumps({"made_with": TAGS, "digests": digests}, indent=2) + "\n", encoding="utf-8")
    assert digests == stored()["digests"]
