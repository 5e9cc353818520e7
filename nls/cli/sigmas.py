"""``nls solve --sigmas estimate``: scales on the stated sigmas, and what table and report say of them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nls.analysis import VarianceComponents
    from nls.graph import FactorGraph
    from nls.io import LoadReport

__all__ = ["doubts", "record"]

OF_KIND = ("measurements", "numbers", "redundancy", "scale", "known")  # fields of the report


def refuse(sigmas: str, robust: str | None, improve: bool) -> None:
    """Refuse scales from measurements that were chosen by the stated sigmas, or from an optimum that may be left.

    Raises
    ------
    OptionError
    """
    from models.errors import OptionError
    from nls.cli import outliers

    if sigmas != "stated" and outliers.is_gnc(robust):
        allowed = (
            f"stated with --robust {robust}, which rejects by the stated sigmas; a kernel such as cauchy goes with it"
        )
        raise OptionError("--sigmas", sigmas, allowed)
    if sigmas != "stated" and improve:
        allowed = "stated with --improve: scales hold for the optimum they were estimated at; --certify goes with it"
        raise OptionError("--sigmas", sigmas, allowed)


def rescaled_report(report: LoadReport, before: FactorGraph, after: FactorGraph) -> LoadReport:
    """The report of the rescaled graph: its times; the matrices of the lines do not hold any more."""
    times = {id(factor): times for factor, times in report.factor_times}
    pairs = zip(before.factors, after.factors, strict=True)
    return replace(
        report, factor_times=[(new, times[id(old)]) for old, new in pairs if id(old) in times], statements=[]
    )


def record(estimated: VarianceComponents) -> dict[str, Any]:
    """For programs."""
    return {
        "settled": estimated.settled,
        "rounds": estimated.rounds,
        "kinds": [
            {"kind": c.name, "scale_sigma": c.sigma} | {name: getattr(c, name) for name in OF_KIND}
            for c in estimated.components
        ],
        "correlation": estimated.correlation.tolist(),
    }


def rows(estimated: VarianceComponents) -> list[str]:
    """For the table."""
    return [f"sigmas      {component}" for component in estimated.components]


def doubts(estimated: VarianceComponents) -> list[str]:
    """Why the scales are no estimate."""
    if estimated.settled:
        return []
    return [
        f"the scales of the sigmas did not settle in {estimated.rounds} rounds; start from a better point with --init, "
        "or estimate fewer scales with --sigmas estimate"
    ]
