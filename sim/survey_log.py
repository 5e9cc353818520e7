"""A simulated survey: the tables its sensors wrote, and the answer apart."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from models.algebra import Array, Mask, distance_along
from models.geodesy import LocalPlane
from sim.survey_track import TrueTrack

__all__ = ["SurveyLog", "Tables"]

Tables = dict[str, dict[str, npt.NDArray[Any]]]  # by file, then by column


@dataclass(frozen=True)
class SurveyLog:
    """The raw log of a simulated survey together with its answer.

    Attributes
    ----------
    name : of the function that made it.
    tables : what the sensors and the operator wrote: by file of a mission folder, then by column, arrays (n,).
    track : the truth: where the vehicle was at any time.
    beacons : (4, 3) true places of the beacons, m, in the order of their numbers.
    landmarks : (m, 3) true places of the landmarks that the sonar saw, m, in the order of their numbers.
    calibration : true values by the names of calibration.csv.
    wrong : (n,) which rows of usbl.csv are wrong on purpose.
    plane : where x = y = 0 is on the Earth.
    seed : the whole number the generator was made from; None where it was made in another way.
    description : what the survey is, in sentences with the numbers.
    """

    name: str
    tables: Tables
    track: TrueTrack = field(repr=False)
    beacons: Array = field(repr=False)
    landmarks: Array = field(repr=False)
    calibration: dict[str, float]
    wrong: Mask = field(repr=False)
    plane: LocalPlane
    seed: int | None
    description: str

    @property
    def duration(self) -> int:
        """From the first measurement to the last, s."""
        return self.track.duration

    @property
    def distance(self) -> float:
        """Length of the true way between them, m."""
        p = self.track.position(np.linspace(0.0, self.duration, 10 * self.duration + 1))
        return float(distance_along(p)[-1])
