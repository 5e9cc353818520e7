"""The certificate of ``nls solve --certify`` and ``--improve``: rows of the table, fields of the report."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from models.advice import listed

if TYPE_CHECKING:
    from nls.certificate import Certificate


# fields of the report for programs that are as in the certificate
SAME = "verdict chi2_given chi2_reached reached lower_chi2 cost_given cost proved lowest converged steps"


def record(certificate: Certificate, refuted: list[float]) -> dict[str, Any]:
    """For programs; lengths in m, angles in rad; chi2 of the solutions that were `refuted`, or loose, and left."""
    same = {name: getattr(certificate, name) for name in SAME.split()}
    both = [("moved", certificate.moved), ("moved_rms", certificate.moved_rms)]
    pairs = {name: dict(zip(("distance", "angle"), pair, strict=True)) for name, pair in both}
    return {**same, **pairs, "eigenvalues": certificate.eigenvalues.tolist(), "refuted": refuted}


def rows(certificate: Certificate, refuted: list[float]) -> list[str]:
    """For the table."""
    left = [f"improved    left at chi2 {chi2:.9g}: went on from its better poses" for chi2 in refuted]
    text = certificate.report(shell=True).replace("\n", f"\n{'':12}")
    return [*left, *f"certificate {text}".splitlines()]


def summary(certificate: Certificate) -> str:
    """The verdict and the way on, in one line."""
    return "; ".join([certificate.sentence, *listed(certificate.advice, shell=True)])
