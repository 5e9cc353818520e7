r"""How should I fly? How well two views determine the elevation of a point, by the motion between them.

The first view says (r, az), the second z_j(r, az, el; G). Predicted from the first, the second has the covariance C,
and what it says about the elevation beyond that is one number:

    B = dz_j/d(r, az),   c = dz_j/del,   C = R + B R B' + H_G Sigma_G H_G',   R = diag(sigma_r^2, sigma_az^2)

    sigma_el = (c' C^-1 c)^(-1/2)

This is the marginal of el in (r, az, el, G) with G known to Sigma_G. It is local: in-plane motions leave the mirror
image -el just as likely, and that is not in it.

Source: T. Huang, "Acoustic structure from motion", CMU-RI-TR-16-08, 2016, for the motions; the formula is the Schur
complement of the four measurements.

May landmarks be mirrored? Their chi2 on the other side of the plane of the sonar, the poses as they are.

    p(e) = S p(r, az, e),     f(e) = sum |b_i(p(e))|^2,     other = argmin f over elevations e of the other sign

After motion in the plane of the sonar f(e) = f(-e), and nothing tells the sign. Two places count as alike where f
differs by less than 9. They are two places where they are farther apart than two standard deviations.
Nearer ones are one place, which its standard deviation describes.

A level vehicle with a level sonar, 50 landmarks: 39 are named, among them all 23 that are on the wrong side; with 4
for 9 these are 31 and 16. Of 340 landmarks over the sea floor, seen by a tilted sonar, none is.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factors.keys import Keys
from models import SE3
from models.algebra import Array, Mask, apply, dot, product
from models.errors import GraphError
from models.sensors.arcs import second_view
from nls.graph import FactorGraph
from nls.starts.landmarks import Arcs, aperture_of, misfit_of
from nls.values import Values


def elevation_sigma(
    motion: npt.ArrayLike, points: npt.ArrayLike, sigmas: npt.ArrayLike, motion_covariance: npt.ArrayLike | None = None
) -> Array:
    """Standard deviation of the elevation of points after two views.

    Parameters
    ----------
    motion : (7,) pose of the sonar at the second view as seen from that at the first, SE3: x forward, y right, z down.
    points : (..., 3) range, azimuth and elevation at the first view, m and rad.
    sigmas : (2,) of range and azimuth, m and rad, in both views.
    motion_covariance : (6, 6) of the motion, in the frame of the second view, (x, y, z, roll, pitch, yaw); an exactly
        known motion when omitted.

    Returns
    -------
    (...) array
        rad; inf where the second view says nothing, to first order, about the elevation. Compare it with what the
        aperture says without any second view, aperture / sqrt(12).

    Raises
    ------
    GraphError
        Arrays of other shapes; sigmas that are not above 0.
    SingularGeometryError
        A point on the z axis of the second sonar.

    Examples
    --------
    A point 4 m ahead at elevation 0, sigmas 1 cm and 0.25 deg. Half a meter down makes its elevation known to 1.6 deg,
    half a meter ahead to nothing.

    >>> import numpy as np
    >>> sigmas, ahead = [0.01, np.radians(0.25)], [4.0, 0.0, 0.0]
    >>> down = elevation_sigma([0, 0, 0.5, 0, 0, 0, 1], ahead, sigmas)
    >>> forward = elevation_sigma([0.5, 0, 0, 0, 0, 0, 1], ahead, sigmas)
    >>> float(np.degrees(down).round(2)), float(forward)
    (1.63, inf)
    """
    G, h, sigma = SE3.stack(motion), np.asarray(points, dtype=float), np.asarray(sigmas, dtype=float)
    if len(G) != 1 or h.shape[-1:] != (3,) or sigma.shape != (2,) or not (sigma > 0).all():
        raise GraphError(
            f"elevation_sigma: expected one motion (7,), points (..., 3) and sigmas (2,) above 0, got "
            f"{len(G)} motions, points {h.shape} and sigmas {sigma.tolist()}"
        )
    R = np.diag(sigma**2)
    _, (H_G, H_h) = second_view(G, h.reshape(-1, 3))
    B, c = H_h[:, :, :2], H_h[:, :, 2]
    C = R + product(product(B, R), B.mT)
    if motion_covariance is not None:
        Sigma_G = np.asarray(motion_covariance, dtype=float)
        if Sigma_G.shape != (6, 6):
            raise GraphError(f"elevation_sigma: motion_covariance has shape {Sigma_G.shape}, expected (6, 6)")
        C = C + product(product(H_G, Sigma_G), H_G.mT)
    information = dot(c, apply(np.asarray(np.linalg.inv(C)), c))
    with np.errstate(divide="ignore"):
        return np.asarray(1 / np.sqrt(information)).reshape(h.shape[:-1])


def mirrored(graph: FactorGraph, values: Values, points: Keys, S: Array, h: Array, sigma: Array) -> Mask:
    """Which landmarks fit as well on the other side of the sonar that saw them first.

    Parameters
    ----------
    graph, values : with the contacts, at the optimum.
    points : (n,) the landmarks.
    S : (n, 7) poses of the sonar.
    h : (n, 3) the landmarks in its frame: range, azimuth, elevation, m and rad.
    sigma : (n,) standard deviations of the elevations, rad; where one is nan nothing can be told, and it is False.

    Returns
    -------
    (n,) array of bool

    Raises
    ------
    SingularGeometryError
        A place that is tried is on the z axis of one of the sonars.

    Examples
    --------
    Half a meter ahead leaves the sign open, half a meter down does not:

    >>> import numpy as np
    >>> from factors import Diagonal, RangeAzimuth
    >>> from models import SE3, R
    >>> from models.sensors import spherical
    >>> from nls import FactorGraph, Values, kinds
    >>> x, l = kinds("x", "l")
    >>> point = np.array([[4.0, 0.5, 0.4]])
    >>> for step in ([0.5, 0.0, 0.0], [0.0, 0.0, 0.5]):
    ...     poses = np.array([[0, 0, 0, 0, 0, 0, 1], [*step, 0, 0, 0, 1]])
    ...     z = spherical(np.concatenate([point, point - step]))[0]
    ...     contacts = RangeAzimuth(x[[0, 1]], l[[0, 0]], z[:, :2], Diagonal(range=0.01, azimuth=0.005))
    ...     values = Values({x: (SE3, poses), l: (R(3), point)})
    ...     mirrored(FactorGraph([contacts]), values, l[[0]], poses[:1], z[:1], np.array([0.01])).tolist()
    [True]
    [False]
    """
    elevation, columns, steps = h[:, 2], np.arange(len(points)), 24
    largest = np.maximum(aperture_of(graph, points.kind), np.abs(elevation))
    f = misfit_of(graph, values, Arcs(points.kind, values.stack(points.kind).index(points), S, h[:, :2]))
    side, step = np.where(elevation > 0, -1.0, 1.0), largest / steps
    other, lowest = np.zeros(len(points)), f(np.zeros(len(points)))
    # then sixths of such a step, and 36ths, three to either side of the best so far
    for tried in (np.arange(1, steps + 1), np.arange(-3, 4) / 6, np.arange(-3, 4) / 36):
        size = np.clip(side * other + step * tried[:, None], 0.0, largest)
        grid = side * size
        chi2 = np.array([f(row) for row in grid])
        best = np.argmin(chi2, axis=0)
        better = chi2[best, columns] < lowest
        other = np.where(better, grid[best, columns], other)
        lowest = np.where(better, chi2[best, columns], lowest)
    # the poses have settled with the side that stands, so that the other one is a little worse
    return np.asarray((lowest - f(elevation) < 9.0) & (np.abs(other - elevation) > 2.0 * sigma))
