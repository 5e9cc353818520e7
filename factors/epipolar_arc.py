r"""Two poses that observed the same contact: their ranges and azimuths, with the point between them eliminated.

    S_k = X_k o O,   G = S_i^-1 S_j,   f(G, p) = (r, az) in view i and in view j of p = (r, az, el) of view i
    p* = argmin |W (z - f(G, p))|^2,   |el| <= limit,         h(X_i, X_j) = f(G, p*)

The point follows the poses: with A_G, A_p the whitened derivatives of f, columns of A_p left out where the point stays,

    dp*/ddelta = -(A_p' A_p)^-1 A_p' A_G,      W H_G = A_G + A_p dp*/ddelta = (I - A_p (A_p' A_p)^-1 A_p') A_G
    H_j = H_G Ad(O)^-1,    H_i = -H_G Ad(G)^-1 Ad(O)^-1            G <- Exp(-Ad(O)^-1 d_i) G Exp(Ad(O)^-1 d_j)

the projection of Kaufman. With b = W (z - h) it gives b'A_p = 0, so 2 A'b = -grad |b|^2 exactly, at any residual; A
itself is the derivative of -b where b = 0. The elevation stays at an end of the aperture, where b'A_p = 0 holds for
range and azimuth alone, and where it has next to no influence (yaw): there it explains nothing.

Sources: G. Golub, V. Pereyra, "The differentiation of pseudo-inverses and nonlinear least squares problems whose
variables separate", SIAM J. Numerical Analysis 10, 1973; L. Kaufman, "A variable projection method for solving
separable nonlinear least squares problems", BIT 15, 1975.
"""

from __future__ import annotations

from math import pi

import numpy as np
import numpy.typing as npt

from factors.base import Factor, Jacobians
from factors.keys import Keys
from factors.mount import check_offset, fixed_offset, named_singularity
from factors.noise import Noise, square
from models import SE3, Manifold, Measured
from models.algebra import Array, dot, gram, product
from models.errors import GraphError
from models.options import check_between
from models.sensors.arcs import Contacts, least_information

__all__ = ["EpipolarArc"]

# of what the aperture says about the elevation: less moves no measurement by more than 0.55 sigma, from end to middle.
# Between 0.001 and 0.1 nothing changes; with 1 Levenberg-Marquardt takes 23 iterations on the hull in place of 10.
NOTHING = 0.1


class EpipolarArc(Factor):
    r"""Range and azimuth of one target from two poses, the target eliminated: its elevation by a search on its arc.

    .. math:: h(X_i, X_j) = f(G, p^*), \quad p^* = \arg\min_{|el| \le q_{max}} |z - f(G, p)|^2_\Sigma,

    .. math:: G = (X_i \circ O)^{-1} (X_j \circ O), \quad
              f(G, p) = (r,\ az,\ |q|,\ \mathrm{atan2}(q_y, q_x)), \quad q = G^{-1} p

    Parameters
    ----------
    i, j : the vehicles, SE3.
    z : (n, 4) range, m, and azimuth, rad, from pose i, then both from pose j.
    noise : of ``range_i``, ``azimuth_i``, ``range_j`` and ``azimuth_j``, in this order or by name.
    limit : half of the aperture, q_max, rad.
    offset : pose of the sonar on the vehicle, the same in both views, (7,) or (n, 7); None: no offset.

    Attributes
    ----------
    limit : as given.
    offset : None, or the offsets (1 or n, 7).

    Raises
    ------
    OptionError
        A limit that is no elevation.
    GraphError
        Spaces or shapes that do not fit; a range not above 0; an offset that is not known.
    SingularGeometryError
        At evaluation: a target on the z axis of the second sonar; noise that leaves the target open.

    Notes
    -----
    Four numbers, three of them spent on the target. A contact seen twice says one thing about the relative pose: the
    second lies on the curve of the first one's arc in its image. Six such determine a pose at best.

    Motions in the plane of the sonar fit el and -el equally well. The factor takes the better side, the one below where
    they are equal. The cost is the same on both sides. The statements about heave, roll and pitch are opposite. Yaw
    fits every elevation equally well, and 0 is taken. There, and where the elevation comes to an end of the aperture, A
    changes at once; the cost never does, its gradient only at the mirror and at the yaw. A graph with one is solved by
    Levenberg-Marquardt unless told otherwise. At a residual `check_jacobians` finds the part of the derivative of b
    that the projection leaves out.

    Range and azimuth are fitted by Gauss-Newton steps from the first view. At contacts that belong together, and at
    false ones of 100 sigmas after a motion of half a meter, they arrive; where two images do not overlap, a false one
    may not, and its cost is then too high.

    Examples
    --------
    Five contacts, seen before and after a dive of half a meter. Depth and tilt come from a sensor. The vehicle went
    ahead by 0.3 m, to port by 0.2 m, and turned by 0.1 rad. These come from the contacts alone, with no landmark in the
    graph:

    >>> from factors import ZPR, Diagonal, EpipolarArc
    >>> from models import SE3, euler
    >>> from nls import FactorGraph, Values, kinds
    >>> (x,) = kinds("x")
    >>> before = [[4.0, -0.2], [3.0, 0.1], [5.0, 0.2], [4.5, 0.0], [3.5, -0.1]]
    >>> after = [[3.676, -0.263], [2.82, 0.084], [4.728, 0.154], [4.261, -0.052], [3.214, -0.147]]
    >>> noise = Diagonal(range_i=0.01, azimuth_i=0.004, range_j=0.01, azimuth_j=0.004)
    >>> contacts = EpipolarArc(x[0], x[[1] * 5], [a + b for a, b in zip(before, after)], noise, limit=0.12)
    >>> graph = FactorGraph([contacts, ZPR(x[1], [0.5, 0.0, 0.0], Diagonal(z=0.01, pitch=0.002, roll=0.002))])
    >>> graph.fix(x[0])
    >>> result = graph.optimize(Values({x: (SE3, SE3.identity(2))}))
    >>> euler.from_se3(result.values[x[1]])[2:].round(2), result.dof  # yaw, x, y, z
    (array([ 0.1,  0.3, -0.2,  0.5]), 2)
    """

    relative = True
    per_measurement = ("offset",)
    eliminated = 3
    damped = True
    slots = (SE3, SE3)
    measures = ("range_i", "azimuth_i", "range_j", "azimuth_j")

    def __init__(
        self,
        i: Keys,
        j: Keys,
        z: npt.ArrayLike,
        noise: Noise,
        limit: float,
        offset: npt.ArrayLike | None = None,
    ) -> None:
        super().__init__((i, j), z, noise)
        self.limit = check_between("EpipolarArc: limit", limit, 0, pi / 2, "half an aperture in (0, pi / 2), rad")
        self.offset = None if offset is None else fixed_offset(self, offset)
        if self._z.shape[-1:] == (4,) and (near := self._z.reshape(-1, 4)[:, ::2].min(axis=1) <= 0).any():
            k = int(np.argmax(near))
            named = self.describe(k) if k < len(self) else repr(self)
            message = f"{named}: its ranges are {self._z.reshape(-1, 4)[k, ::2].tolist()} m, expected above 0"
            raise GraphError(message, self.keys, self.name)

    def sizes(self) -> tuple[int, ...]:
        return (len(self.measures),)

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        check_offset(self, self.offset, SE3)
        return Measured(*self.measures)

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        O = SE3.identity() if self.offset is None else self.offset
        G = SE3.between(SE3.compose(X[0], O), SE3.compose(X[1], O))
        z = np.broadcast_to(np.atleast_2d(self.z), (len(G), 4))
        contacts = Contacts(z, square(self.noise.sqrt_information(len(G), self.measures)), self.limit)
        with named_singularity(self):
            p = contacts.best(G)
            e, H_G, H_p = contacts.innovation(G, p)
        A_G, A_p = product(contacts.W, H_G), product(contacts.W, H_p)
        weak = _elevation_information(A_p) <= NOTHING * least_information(contacts)
        stays = weak | (np.abs(p[:, 2]) >= self.limit)
        A_p = np.where(stays[:, None, None], A_p * [1.0, 1.0, 0.0], A_p)
        N = gram(A_p) + stays[:, None, None] * np.diag([0.0, 0.0, 1.0])
        dp = -np.asarray(np.linalg.solve(N, product(A_p.mT, A_G)))
        H_G = H_G + product(H_p, dp)
        Ad_O = SE3.adjoint_inverse(O)
        return z - e, (-product(H_G, product(SE3.adjoint_inverse(G), Ad_O)), product(H_G, Ad_O))  # azimuths beside z


def _elevation_information(A_p: Array) -> Array:
    """The information (m,) about el where r and az are unknown, 1/m^2: the Schur complement in A_p' A_p."""
    r, az, el = (A_p[:, :, k] for k in range(3))
    p, q, s, u, v = dot(r, r), dot(r, az), dot(az, az), dot(r, el), dot(az, el)
    return dot(el, el) - (s * u * u - 2 * q * u * v + p * v * v) / (p * s - q * q)
