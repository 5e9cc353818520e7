r"""A point on the arc of one sonar image, seen again after the sonar has moved: prediction and derivatives.

    q = G^-1 p(r, az, el),   z_j = (|q|, atan2(q_y, q_x)),   G = S_i^-1 S_j      sonar j as seen from sonar i

    dz_j/d(r, az, el) = J(q) R_G' dp/d(r, az, el)            dz_j/ddelta = J(q) [-I, [q]x],   G <- G Exp(delta)

The third column of the first is all that is ever learned about the elevation. It vanishes for every elevation when the
sonar only yaws, and on the plane el = 0 for every motion in that plane (surge, sway, yaw).
"""

from __future__ import annotations

from models import SE3
from models.algebra import Array, product
from models.sensors import cartesian, point_in_frame, range_azimuth

__all__ = ["second_view"]


def second_view(G: Array, h: Array) -> tuple[Array, tuple[Array, Array]]:
    """What the second view measures of points of the first.

    Parameters
    ----------
    G : (1 or n, 7) motion of the sonar, SE3.
    h : (n, 3) range, azimuth and elevation in the first view, m and rad.

    Returns
    -------
    z : (n, 2) range and azimuth in the second, m and rad.
    H_G, H_h : (n, 2, 6) and (n, 2, 3).

    Raises
    ------
    SingularAt
        A point on the z axis of the second sonar.

    Examples
    --------
    >>> import numpy as np
    >>> heave = np.array([[0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 1.0]])
    >>> z, (_, H_h) = second_view(heave, np.array([[4.0, 0.0, 0.0]]))
    >>> z.round(3), H_h[0, :, 2].round(3)  # 0.3 m down: of 1 rad of elevation 0.3 m of range
    (array([[4.011, 0.   ]]), array([-0.299,  0.   ]))
    """
    p, P = cartesian(h)
    q, (H_G, H_p) = point_in_frame(SE3, G, p)
    z, J = range_azimuth(q)
    return z, (product(J, H_G), product(J, product(H_p, P)))
