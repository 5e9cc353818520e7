"""Beacons that several dives know: where two surveys contradict each other, and where one survey would count twice."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from factors import Diagonal, Prior
from factors.base import Factor
from models.algebra import Array
from models.errors import GraphFileError
from nls.graph import FactorGraph
from nls.io.mission.report import MissionReport
from nls.io.report import Source

__all__ = ["refuse_moved_beacons", "without_known_beacons"]

APART = 5.0  # sigmas: one beacon in two places


def _beacon_priors(factors: Sequence[Factor]) -> list[tuple[int, Prior]]:
    """The priors of beacons, and their place among the factors."""
    return [(k, f) for k, f in enumerate(factors) if isinstance(f, Prior) and f.keys[0].kind == "b"]


def refuse_moved_beacons(dives: Sequence[tuple[FactorGraph, MissionReport]]) -> None:
    """Refuse beacons that the dives have in different places.

    Raises
    ------
    GraphFileError
    """
    places: dict[int, tuple[Array, Array, str]] = {}
    for graph, report in dives:
        for k, prior in _beacon_priors(graph.factors):
            sigmas = np.asarray(prior.noise.sigmas) if isinstance(prior.noise, Diagonal) else np.zeros(0)
            for row, number in enumerate(prior.keys[0].numbers.tolist()):
                z, sigma, where = prior.z[row], sigmas[row], report.place(k, row)
                other = places.setdefault(number, (z, sigma, where))
                if len(z) == len(other[0]) and (np.abs(z - other[0]) > APART * np.hypot(sigma, other[1])).any():
                    path, _, line = where.rpartition(":")
                    raise GraphFileError(
                        f"beacon {number} is {np.linalg.norm(z - other[0]):.4g} m from where {other[2]} has it; the "
                        "same number is the same beacon, so give another one a number of its own",
                        path,
                        int(line),
                    )


def without_known_beacons(own: FactorGraph, report: MissionReport, others: Sequence[Factor]) -> FactorGraph:
    """A dive without rows of its beacons.csv that the factors of others have word by word: one survey counts once."""
    known = {
        (number, *prior.z[row].tolist(), *np.asarray(prior.noise.sigmas)[row].tolist())
        for _, prior in _beacon_priors(others)
        if isinstance(prior.noise, Diagonal)
        for row, number in enumerate(prior.keys[0].numbers.tolist())
    }
    factors, sources = list(own.factors), list(report.sources)
    for k, prior in reversed(_beacon_priors(own.factors)):
        assert isinstance(prior.noise, Diagonal)
        sigmas = np.asarray(prior.noise.sigmas)
        rows = [
            row
            for row, number in enumerate(prior.keys[0].numbers.tolist())
            if (number, *prior.z[row].tolist(), *sigmas[row].tolist()) not in known
        ]
        if len(rows) < len(prior):
            report.notes.append(
                f"beacons.csv has {len(prior) - len(rows)} rows that another dive has, too: counted once"
            )
            factors[k : k + 1] = [prior[np.array(rows)]] if rows else []
            lines = Source(sources[k].path, sources[k].lines[rows])
            sources[k : k + 1] = [lines] if rows else []
    report.sources = sources
    return FactorGraph(factors, own.fixed)
