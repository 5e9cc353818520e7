"""The certificate of ``nls solve --certify`` and ``--improve``: rows of the table, fields of the report."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from models.advice import listed

if TYPE_CHECKING:
    from nls.certificate import Certificate


def record(certificate: Certificate, refuted: list[float]) -> dict[str, Any]:
    """For programs; lengths in m, angles in rad; chi2 of the solutions that were `refuted` and left."""
    return {
        "verdict": certificate.verdict,
        "chi2_given": certificate.chi2_given,
        "chi2_reached": certificate.chi2_reached,
        "reached": certificate.reached,
        "lower_chi2": certificate.lower_chi2,
        "cost_given": certificate.cost_given,
        "cost": certificate.cost,
        "proved": certificate.proved,
        "lowest": certificate.lowest,
        "eigenvalues": certificate.eigenvalues.tolist(),
        "moved": dict(zip(("distance", "angle"), certificate.moved, strict=True)),
        "moved_rms": dict(zip(("distance", "angle"), certificate.moved_rms, strict=True)),
        "converged": certificate.converged,
        "steps": certificate.steps,
        "refuted": refuted,
    }


def rows(certificate: Certificate, refuted: list[float]) -> list[str]:
    """For the table."""
    first, *lines = certificate.report(shell=True).splitlines()
    left = [f"improved    refuted at chi2 {chi2:.9g}: went on from its better poses" for chi2 in refuted]
    return [*left, f"certificate {first}", *(f"            {line}" for line in lines)]


def summary(certificate: Certificate) -> str:
    """The verdict and the way on, in one line."""
    first, *_ = certificate.report().splitlines()
    return "; ".join([first, *listed(certificate.advice, shell=True)])
