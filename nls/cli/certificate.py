"""The certificate of ``nls solve --certify``: rows of the table, fields of the report."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nls.certificate import Certificate


def record(certificate: Certificate) -> dict[str, Any]:
    """For programs; lengths in m, angles in rad."""
    return {
        "verdict": certificate.verdict,
        "cost": certificate.cost,
        "cost_given": certificate.cost_given,
        "lowest": certificate.lowest,
        "better_cost": certificate.better_cost,
        "lower_chi2": certificate.lower_chi2,
        "eigenvalues": certificate.eigenvalues.tolist(),
        "moved": dict(zip(("distance", "angle"), certificate.moved, strict=True)),
        "moved_rms": dict(zip(("distance", "angle"), certificate.moved_rms, strict=True)),
        "converged": certificate.converged,
        "steps": certificate.steps,
    }


def rows(certificate: Certificate) -> list[str]:
    """For the table."""
    first, *lines = certificate.report(shell=True).splitlines()
    return [f"certificate {first}", *(f"            {line}" for line in lines)]
