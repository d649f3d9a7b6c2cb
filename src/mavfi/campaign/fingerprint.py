"""Inputs, next to the scenario, that determine a flight bit for bit: versions, code, shipped files, architecture."""

import functools
import hashlib
import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from mavfi.config import config_root
from mavfi.version import __version__

_SHORT = 60
"""Characters of two values up to which they are shown."""
_MOST = 6
"""Differences that are named."""

_PACKAGES = ("numpy", "numba", "llvmlite", "mujoco-core", "scikit-learn")


def versions() -> dict[str, str]:
    """Versions on which the bits of a flight depend."""
    by_package = {"mavfi": __version__}
    for package in _PACKAGES:
        try:
            by_package[package] = version(package)
        except PackageNotFoundError:
            by_package[package] = "absent"
    return by_package


def python() -> str:
    """Python version, which determines the bytecode compiled by Numba, e.g. "3.11"."""
    return ".".join(platform.python_version_tuple()[:2])


def processor() -> str:
    """Model name of the processor, as reported by the operating system."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def code() -> str:
    """Hash of the package's source."""
    return _hash(Path(__file__).parents[1], "*.py")


@functools.cache
def fingerprint() -> Mapping[str, str]:
    """Properties that must agree on all machines that fly missions of one campaign.

    All x86-64 processors give the same bits; other architectures are untested.
    """
    return {
        **versions(),
        "python": python(),
        "architecture": platform.machine(),
        "code": code(),
        "configs": _hash(config_root(), "*.yaml"),
    }


def difference(wanted: Mapping[str, str], here: Mapping[str, str]) -> str:
    """Description of the first differing property; "" = all agree."""
    for name, value in wanted.items():
        if here.get(name) != value:
            return f"{name} {here.get(name, 'absent')[:12]}, the campaign {value[:12]}"
    return ""


def differences(held: Mapping[str, Any], wanted: Mapping[str, Any]) -> str:
    """In what two identities of campaigns differ, as text; "" = they are equal.

    Keys of scenarios are named, e.g. "scenarios.protection"; keys of campaigns have both values if these are short,
    e.g. "campaign.faults: 4, not 5".
    """
    texts = _differing(held, wanted)
    if "campaign" in texts:
        texts.remove("campaign")
        held_keys = held.get("campaign") or {}
        wanted_keys = wanted.get("campaign") or {}
        for key in _differing(held_keys, wanted_keys):
            values = held_keys.get(key), wanted_keys.get(key)
            text = f"campaign.{key}: {values[0]}, not {values[1]}"
            if len(f"{values[0]}, not {values[1]}") > _SHORT or any(isinstance(value, dict) for value in values):
                text = f"campaign.{key}"
            texts.add(text)
    held_scenarios = held.get("scenarios") or {}
    wanted_scenarios = wanted.get("scenarios") or {}
    if "scenarios" in texts and held_scenarios.keys() == wanted_scenarios.keys():
        texts.remove("scenarios")
        for name, scenario in held_scenarios.items():
            texts |= {f"scenarios.{key}" for key in _differing(scenario, wanted_scenarios[name])}
    text = ", ".join(sorted(texts)[:_MOST])
    if len(texts) > _MOST:
        text += f" and {len(texts) - _MOST} more"
    return text


def _differing(held: Mapping[str, Any], wanted: Mapping[str, Any]) -> set[str]:
    """Keys whose values differ."""
    return {key for key in {*held, *wanted} if held.get(key) != wanted.get(key)}


def _hash(folder: Path, pattern: str) -> str:
    content = hashlib.sha256()
    for path in sorted(folder.rglob(pattern)):
        content.update(f"{path.relative_to(folder)}\n".encode() + path.read_bytes())
    return content.hexdigest()
