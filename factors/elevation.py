"""The elevation an imaging sonar does not measure: known from elsewhere, or only that the target was in sight."""

from __future__ import annotations

from math import inf, pi

import numpy as np
import numpy.typing as npt

from factors.base import Jacobians
from factors.keys import Keys
from factors.noise import Isotropic
from factors.range_azimuth import InSpace
from models import Manifold
from models.algebra import Array
from models.options import check_between
from models.sensors import elevation

__all__ = ["Elevation", "ElevationHinge"]


class Elevation(InSpace):
    r"""Elevation of a target in the frame of a sonar; x ahead, y to starboard, z down: positive below.

    .. math:: h(X, l) = \mathrm{atan2}(p_z, \sqrt{p_x^2 + p_y^2}), \quad p = (X \circ O)^{-1} l

    Parameters
    ----------
    pose : the vehicle(s), SE3.
    target : the point(s), R(3); or other poses, of which the position is meant.
    z : (n,) elevations, rad.
    noise : of ``elevation``, rad.
    offset : pose of the sonar on the vehicle, (7,) or (n, 7), or a variable in SE3; None: no offset.

    Raises
    ------
    GraphError
        Spaces or shapes that do not fit.
    SingularGeometryError
        At evaluation: a target on the z axis of the sonar.

    Notes
    -----
    With z = 0 it is the Gaussian prior of an aperture, which is biased at first sight: a vehicle that moves ahead sees
    every target first at the same edge of the aperture. `ElevationHinge` is not.

    Examples
    --------
    >>> from factors import Diagonal, Elevation, Isotropic, RangeAzimuth
    >>> from models import SE3, R
    >>> from nls import FactorGraph, Values, kinds
    >>> x, l = kinds("x", "l")
    >>> contact = RangeAzimuth(x[0], l[0], [5.0, 0.0], Diagonal(range=0.01, azimuth=0.005))
    >>> graph = FactorGraph([contact, Elevation(x[0], l[0], 0.6435, Isotropic(0.01))])
    >>> graph.fix(x[0])
    >>> graph.optimize(Values({x: (SE3, SE3.identity()), l: (R(3), [5.0, 0.0, 1.0])})).values[l[0]].round(3)
    array([4., 0., 3.])
    """

    measures = ("elevation",)

    def sense(self, p: Array) -> tuple[Array, Array]:
        return elevation(p)


class ElevationHinge(Elevation):
    r"""A target was in the aperture when it was seen: no cost inside, a quadratic one outside.

    .. math:: h(X, l) = \mathrm{sign}(q) \max(|q| - q_{max}, 0), \quad q = \mathrm{atan2}(p_z, \sqrt{p_x^2 + p_y^2}),

    .. math:: p = (X \circ O)^{-1} l

    with z = 0 and a sigma of `softness`: the residual is 0 inside, :math:`\pm(q_{max} - |q|)/s` outside.

    Parameters
    ----------
    pose : the vehicle(s), SE3.
    target : the point(s), R(3); or other poses, of which the position is meant.
    limit : half of the aperture, q_max, rad.
    softness : s, the elevation beyond the limit that costs as much as an error of one sigma, rad.
    offset : pose of the sonar on the vehicle, (7,) or (n, 7), or a variable in SE3; None: no offset.

    Raises
    ------
    OptionError
        A limit that is no elevation; a softness that is not above 0.
    SingularGeometryError
        At evaluation: a target on the z axis of the sonar.

    Notes
    -----
    Inside the aperture nothing is added to the information. A target that only the hinge keeps in place is free there,
    and a covariance says so. One that pushes counts there as a measurement as good as its softness, which is more than
    a limit knows; for the landmarks of a mission `nls.missions.elevations` puts the aperture in its place. Which
    hinges push changes from step to step, so undamped Gauss-Newton may go in a circle; a graph with one is solved by
    Levenberg-Marquardt unless told otherwise.

    Examples
    --------
    >>> from math import radians
    >>> from factors import ElevationHinge
    >>> from models import SE3, R
    >>> from nls import Values, kinds
    >>> x, l = kinds("x", "l")
    >>> hinge = ElevationHinge(x[0], l[[0, 1]], limit=radians(7), softness=radians(1))
    >>> seen = Values({x: (SE3, SE3.identity()), l: (R(3), [[5.0, 0.0, 0.5], [5.0, 0.0, 1.0]])})  # at 5.7 and 11.3 deg
    >>> hinge.chi2(seen).round(2)
    array([ 0.  , 18.57])
    """

    limit_only = True
    damped = True

    def __init__(
        self,
        pose: Keys,
        target: Keys,
        limit: float,
        softness: float = pi / 180,
        offset: npt.ArrayLike | Keys | None = None,
    ) -> None:
        sigma = check_between("ElevationHinge: softness", softness, 0, inf, "an elevation above 0, rad")
        super().__init__(pose, target, 0.0, Isotropic(sigma), offset)
        self.limit = check_between("ElevationHinge: limit", limit, 0, pi / 2, "half an aperture in (0, pi / 2), rad")

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        q, H = super().predict(manifolds, *X)
        assert H is not None
        beyond = np.maximum(np.abs(q) - self.limit, 0.0)
        outside = (beyond > 0)[..., None]
        return np.sign(q) * beyond, tuple(np.where(outside, H_k, 0.0) for H_k in H if H_k is not None)
