r"""The camera of the "bundle adjustment in the large" data sets: nine parameters, looking along its own *negative* z.

With a rotation vector w and translation t, world to camera, a point X, focal length f, radial distortion k1, k2:

    P = R(w) X + t                   dP/dw = -[R X]x J_l(w),     dP/dt = I,     dP/dX = R(w)
    p = -P_xy / P_z                  dp/dP = -[I, p] / P_z
    r = 1 + k1 |p|^2 + k2 |p|^4
    h = f r p                        dh/dp = f (r I + (2 k1 + 4 k2 |p|^2) p p'),
                                     dh/d(f, k1, k2) = [r p, f |p|^2 p, f |p|^4 p]

pixels from the middle of the image, x to the right, y up. A point in front has P_z < 0; one behind (P_z > 0) has an
image in the formula all the same, and the data sets do not exclude it: nothing is refused here but P_z = 0.

Source: S. Agarwal, N. Snavely, S. Seitz, R. Szeliski, "Bundle adjustment in the large", ECCV 2010.
"""

from __future__ import annotations

import numpy as np

from models.algebra import Array, apply, components, matrix, pack, product, skew
from models.manifolds.so3 import SO3
from models.sensors.singular import refuse

__all__ = ["project"]

GRAZING = 1e-9  # |P_z| / |P| below this: 1e9 focal lengths from the middle of the image


def project(camera: Array, intrinsics: Array, X: Array) -> tuple[Array, tuple[Array, Array, Array]]:
    """Image of points.

    Parameters
    ----------
    camera : (n, 6) rotation vector and translation, world to camera, rad and the unit of length.
    intrinsics : (n, 3) focal length f, pixels, and k1, k2.
    X : (n, 3) points of the world.

    Returns
    -------
    h : (n, 2) pixels.
    H_camera, H_intrinsics, H_X : (n, 2, 6), (n, 2, 3), (n, 2, 3).

    Raises
    ------
    SingularAt
        A point in the plane of the camera, P_z = 0.

    Examples
    --------
    >>> import numpy as np
    >>> h, _ = project(np.array([[0, 0, 0, 0, 0, -2.0]]), np.array([[100.0, 0.1, 0.0]]), np.array([[1.0, 0.0, 0.0]]))
    >>> h
    array([[51.25, 0. ]])
    """
    w, t = camera[:, :3], camera[:, 3:]
    R = SO3.rotation(SO3.exp(w))
    RX = apply(R, X)
    Px, Py, Pz = components(RX + t)
    refuse(
        np.abs(Pz) <= GRAZING * np.sqrt(Px * Px + Py * Py + Pz * Pz),
        "the point is in the plane of the camera (P_z = 0) and has no image; check its initial value",
    )
    u, v = -Px / Pz, -Py / Pz
    f, k1, k2 = components(intrinsics)
    s = u * u + v * v
    r = 1 + s * (k1 + s * k2)
    h = pack([f * r * u, f * r * v])
    g = f * (2 * k1 + 4 * k2 * s)
    h_p = matrix([[f * r + g * u * u, g * u * v], [g * u * v, f * r + g * v * v]])
    p_P = matrix([[-1 / Pz, 0.0, -u / Pz], [0.0, -1 / Pz, -v / Pz]])
    H_t = product(h_p, p_P)
    H_w = -product(H_t, product(skew(RX), SO3.jl(w)))
    H_f = matrix([[r * u, f * s * u, f * s * s * u], [r * v, f * s * v, f * s * s * v]])
    return h, (np.concatenate([H_w, H_t], axis=-1), H_f, product(H_t, R))
