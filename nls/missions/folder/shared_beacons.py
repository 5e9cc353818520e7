"""Beacons that several dives know: where two surveys contradict each other, and where one survey would count twice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from factors import Diagonal, Prior
from factors.base import Factor
from models.algebra import Array
from models.errors import GraphFileError
from nls.graph import FactorGraph
from nls.io.report import Source
from nls.missions.folder.report import MissionReport

__all__ = ["refuse_moved_beacons", "without_known_beacons"]

APART = 5.0  # sigmas: one beacon in two places
AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Survey:
    """One row of beacons.csv.

    Attributes
    ----------
    number : of the beacon.
    z, sigmas : (3,) m; where a component is not measured, z is 0 and its sigma infinite.
    factor, row : where it is among the factors of its graph.
    """

    number: int
    z: Array
    sigmas: Array
    factor: int
    row: int

    @property
    def words(self) -> tuple[float, ...]:
        """All numbers of the row."""
        return self.number, *self.z.tolist(), *self.sigmas.tolist()


def _surveys(factors: Sequence[Factor]) -> list[Survey]:
    """The rows of beacons.csv among factors."""
    surveys = []
    for k, prior in enumerate(factors):
        if not isinstance(prior, Prior) or prior.keys[0].kind != "b":
            continue
        assert isinstance(prior.noise, Diagonal)  # read from a table
        measured = [AXES.index(name) for name in prior.components or AXES]
        sigmas = np.full((len(prior), len(AXES)), np.inf)
        sigmas[:, measured] = prior.noise.sigmas
        z = np.where(np.isfinite(sigmas), prior.z, 0.0)
        numbers = prior.keys[0].numbers.tolist()
        surveys += [Survey(number, z[row], sigmas[row], k, row) for row, number in enumerate(numbers)]
    return surveys


def refuse_moved_beacons(dives: Sequence[tuple[FactorGraph, MissionReport]]) -> None:
    """Refuse beacons that two dives have in different places, by the components that both measure.

    Raises
    ------
    GraphFileError
    """
    known: dict[int, list[tuple[Survey, str]]] = {}
    for graph, report in dives:
        for survey in _surveys(graph.factors):
            place = report.place(survey.factor, survey.row)
            others = known.setdefault(survey.number, [])
            for other, where in others:
                sigma = np.hypot(survey.sigmas, other.sigmas)
                away = np.where(np.isfinite(sigma), survey.z - other.z, 0.0)
                if (np.abs(away) > APART * sigma).any():
                    path, _, line = place.rpartition(":")
                    raise GraphFileError(
                        f"beacon {survey.number} is {np.linalg.norm(away):.4g} m from where {where} has it; the same "
                        "number is the same beacon, so give another one a number of its own",
                        path,
                        int(line),
                    )
            others.append((survey, place))


def without_known_beacons(own: FactorGraph, report: MissionReport, others: Sequence[Factor]) -> FactorGraph:
    """A dive without rows of its beacons.csv that the factors of others have word by word: one survey counts once."""
    known = {survey.words for survey in _surveys(others)}
    surveys = _surveys(own.factors)
    factors, sources = list(own.factors), list(report.sources)
    for k in sorted({survey.factor for survey in surveys}, reverse=True):
        prior = factors[k]
        rows = [survey.row for survey in surveys if survey.factor == k and survey.words not in known]
        if len(rows) < len(prior):
            report.notes.append(
                f"beacons.csv has {len(prior) - len(rows)} rows that another dive has, too: counted once"
            )
            factors[k : k + 1] = [prior[np.array(rows)]] if rows else []
            lines = Source(sources[k].path, sources[k].lines[rows])
            sources[k : k + 1] = [lines] if rows else []
    report.sources = sources
    return FactorGraph(factors, own.fixed)
