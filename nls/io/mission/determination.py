"""Whether the data of a mission determine its calibrations: how much of what was not known before is left.

    share = sigma after all measurements / sigma of the row in calibration.csv

1 where no measurement says anything, near 0 where they say everything. A calibration that keeps `LEFT` of its sigma is
not determined: its value is the one it was believed to be.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.keys import Kind
from nls.covariance import Marginals
from nls.io.mission.report import MissionReport
from nls.values import Values

__all__ = ["Determination", "determinations"]

LEFT = 0.9  # of the sigma: 81 % of the variance


@dataclass(frozen=True)
class Determination:
    """An estimated calibration.

    Attributes
    ----------
    name : in calibration.csv; ``gyro_bias`` is that of the first minute.
    value, sigma : after the measurements; sigma is None where it is not known.
    believed, sigma_before : before them.
    """

    name: str
    value: float
    sigma: float | None
    believed: float
    sigma_before: float

    @property
    def share(self) -> float | None:
        """The part of the sigma before the measurements that is left."""
        return None if self.sigma is None else self.sigma / self.sigma_before

    @property
    def sigmas_away(self) -> float:
        """How far the estimate is from what was believed, in sigmas before the measurements."""
        return abs(self.value - self.believed) / self.sigma_before

    @property
    def determined(self) -> bool | None:
        """Whether the measurements say more of it than was known before."""
        return None if self.share is None else self.share <= LEFT


def determinations(values: Values, report: MissionReport, marginals: Marginals | None) -> list[Determination]:
    """The calibrations of a solved mission, in the order of calibration.csv.

    Parameters
    ----------
    values, report : the solution of a mission.
    marginals : its covariances; None where there are none, so that no sigma is known.
    """
    rows = []
    for name, (believed, before) in report.calibrations.items():
        kind, sigma = Kind(name), None
        if marginals is not None and marginals.status(kind)[0] == "estimated":
            sigma = float(np.sqrt(marginals.covariance(kind[0])[0, 0]))
        rows.append(Determination(name, float(values[kind[0]][0]), sigma, believed, before))
    return rows
