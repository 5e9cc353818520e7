r"""Simulated rigs of a camera and a sonar, and the distance of an estimate from the truth.

    images      z = h(x_i, l_k) + v        pixels (u, v) of point k from camera i
    contacts    z = h(x_i o s, l_k) + v    range and azimuth of the same points, s the sonar in the frame of the camera

Errors of poses and points are measured after one rigid motion T of the whole estimate. T is that of least squares over
the positions of cameras and points together; no scale is estimated. The mounting s needs no alignment.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors import Projection, RangeAzimuth
from models import SE3
from models.algebra import Array
from models.alignment import align
from models.errors import GraphError
from models.sensors import Camera
from nls import Values
from sim.world import Simulated

__all__ = ["Rig", "RigErrors"]

KINDS = ("x", "l", "s")


@dataclass(frozen=True)
class RigErrors:
    """How far an estimate of a rig is from its truth; ``print`` gives the sentence with the alignment.

    Attributes
    ----------
    poses, points : root mean square distance of the positions of cameras and points, m, after a rigid alignment of both
        together.
    extrinsic_m, extrinsic_rad : of the sonar in the frame of the camera, distance of the positions and angle between
        the axes, nothing aligned.
    """

    poses: float
    points: float
    extrinsic_m: float
    extrinsic_rad: float

    def __str__(self) -> str:
        return (
            f"cameras {100 * self.poses:.2f} cm, points {100 * self.points:.2f} cm rmse (alignment: rigid, of both "
            f"together); sonar on the camera {100 * self.extrinsic_m:.2f} cm, {np.degrees(self.extrinsic_rad):.2f} deg"
        )


@dataclass(frozen=True)
class Rig(Simulated):
    """A simulated rig together with its answer.

    Attributes
    ----------
    name : of the function that made it.
    truth : camera poses, kind ``x`` in SE3, camera to world; points, kind ``l`` in R(3); the pose of the sonar in the
        frame of the camera, ``s[0]`` in SE3.
    graph : `Projection` and `RangeAzimuth`, in this order, of the same pairs; the first pose is fixed.
    start : from the measurements and a poor guess of the sonar's pose.
    camera : its calibration.
    seed : the whole number the generator was made from; None where it was made in another way.
    description : what the rig is, in sentences with the numbers.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> rig = sim.rig(np.random.default_rng(1), poses=6, points=80)
    >>> result = rig.graph.optimize(rig.start)
    >>> before, after = rig.errors(rig.start), rig.errors(result.values)
    >>> result.converged, after.points < before.points / 2, after.extrinsic_m < before.extrinsic_m
    (True, True, True)
    """

    camera: Camera
    seed: int | None
    description: str

    @property
    def images(self) -> Projection:
        """The measurements of the camera."""
        return self.measured(0, Projection)

    @property
    def contacts(self) -> RangeAzimuth:
        """The measurements of the sonar."""
        return self.measured(1, RangeAzimuth)

    @property
    def points(self) -> int:
        """Number of points."""
        return self.landmarks

    @property
    def rows(self) -> int:
        """Measured numbers, the rows of A: the expected chi2 at the truth."""
        return 2 * len(self.graph)

    @property
    def dof(self) -> int:
        """Rows minus free columns, the first pose being fixed: the expected chi2 at the optimum."""
        return self.rows - (self.truth.dim - SE3.dim)

    def errors(self, values: Values) -> RigErrors:
        """Distance of an estimate from the truth.

        Parameters
        ----------
        values : poses, points and the sonar's pose, the same variables as those of `truth`.

        Raises
        ------
        GraphError
            Other variables.
        """
        for kind in KINDS:
            ours, true = values.stack(kind), self.truth.stack(kind)
            if ours.manifold is not true.manifold or not np.array_equal(ours.numbers, true.numbers):
                raise GraphError(f"errors: the estimate is {values!r}, the truth {self.truth!r}; expected the same")
        estimate, truth = _positions(values), _positions(self.truth)
        away = np.linalg.norm(SE3.act(align(truth, estimate)[None], estimate) - truth, axis=1)
        off = SE3.between(self.truth.stack("s").X, values.stack("s").X)
        turn = SE3.log(off)[0, 3:]
        n = self.poses
        return RigErrors(_rms(away[:n]), _rms(away[n:]), float(np.linalg.norm(off[0, :3])), float(np.linalg.norm(turn)))


def _positions(values: Values) -> Array:
    """Of cameras, then points (n + m, 3)."""
    return np.concatenate([SE3.position(values.stack("x").X), values.stack("l").X])


def _rms(distances: Array) -> float:
    return float(np.sqrt(np.mean(np.square(distances))))
