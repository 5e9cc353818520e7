r"""How should I fly? How well two views determine the elevation of a point, by the motion between them.

The first view says (r, az), the second z_j(r, az, el; G). Predicted from the first, the second has the covariance C,
and what it says about the elevation beyond that is one number:

    B = dz_j/d(r, az),   c = dz_j/del,   C = R + B R B' + H_G Sigma_G H_G',   R = diag(sigma_r^2, sigma_az^2)

    sigma_el = (c' C^-1 c)^(-1/2)

This is the marginal of el in (r, az, el, G) with G known to Sigma_G. It is local: in-plane motions leave the mirror
image -el just as likely, and that is not in it.

Source: T. Huang, "Acoustic structure from motion", CMU-RI-TR-16-08, 2016, for the motions; the formula is the Schur
complement of the four measurements.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from models import SE3
from models.algebra import Array, apply, dot, product
from models.errors import GraphError
from models.sensors.arcs import second_view

__all__ = ["elevation_sigma"]


def elevation_sigma(
    motion: npt.ArrayLike,
    points: npt.ArrayLike,
    sigmas: npt.ArrayLike,
    motion_covariance: npt.ArrayLike | None = None,
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
