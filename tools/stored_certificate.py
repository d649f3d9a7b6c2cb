"""Reads the certificate of a plan back from its JSON, for the tool that makes the pages of results."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from mavfi.analysis.statistics import Paired
from mavfi.extras.hardening.certify import Certificate, Certification, Spending, Unprotected
from mavfi.extras.hardening.observed import GoldenCheck
from mavfi.extras.hardening.plan import Coverage


def certificate_of(content: Mapping[str, Any]) -> Certificate:
    """Inverse of `Certificate.to_json`."""
    plain = ("kernel", "function", "signature", "instructions", "before", "after", "growth", "time", "planned_time")
    predicted = None
    if content["predicted"] is not None:
        predicted = Coverage(**content["predicted"])
    paired = content["paired"]
    return Certificate(
        **{key: content[key] for key in plain},
        predicted=predicted,
        paired=Paired(*(paired[key] for key in ("n", "plain_only", "protected_only", "p"))),
    )


def unprotected_of(content: Mapping[str, Any]) -> Unprotected:
    """Inverse of `Unprotected.to_json`, which also writes the rate of silent corruption."""
    return Unprotected(**{field.name: content[field.name] for field in fields(Unprotected)})


def certification_of(content: Mapping[str, Any]) -> Certification:
    """Inverse of `certification_json`; ones that were written without processor or spending have none."""
    scope: tuple[str, ...] = ()
    if content["kernels"] != "all":
        scope = tuple(content["kernels"])
    return Certification(
        plan=content["plan"],
        faults=content["faults"],
        missions=tuple(content["missions"]),
        certificates=tuple(map(certificate_of, content["functions"])),
        golden=GoldenCheck(**content["golden"]),
        others=tuple(map(unprotected_of, content["unprotected"])),
        scope=scope,
        cpu=content.get("cpu", ""),
        spending=tuple(Spending(**row) for row in content.get("spending", ())),
    )
