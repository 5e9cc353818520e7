r"""Two sonar images of the same points become one factor between two poses: acoustic bundle adjustment of two views.

The unknown is the relative pose T = X_i^-1 X_j of the vehicle, the sonar at G = O^-1 T O. In every iteration each point
is put where its arc fits both images best (`relative_pose.search`), linearized with all three of its coordinates, and
eliminated with a truncated block (`truncated_inverse`):

    S = sum A_T' N A_T - A_T' N A_l (A_l' N A_l)^+ A_l' N A_T,      g likewise with b
    (S + Lambda) dT = g + Lambda (start [-] T)                      Lambda: what odometry knows, the metric of S

damped after Levenberg and Marquardt: first with every point at its best place, then with both places where it has two.

A point with two hypotheses, + and -, counts with the mean of their linearizations, its elevation measured away from
the plane el = 0 on either side, and what they disagree about as further noise of the measurements:

    A = (A(+) + A(-)) / 2,   D = (A_T(+) - A_T(-)) / 2,   d = (b(+) - b(-)) / 2
    N = (I + D Lambda^-1 D' + d d')^-1                              I for a point with one hypothesis

In-plane motions: A is what a point says about surge, sway and yaw, D how its unknown side would mix in heave, roll and
pitch. Nothing is claimed about these by points that do not know their side.

The result is the quadratic of the sonar alone, without odometry: minimum z = T Exp(S^+ g), information S, singular
where the sonar says less than `tau` of what odometry does. `TwoView.factor` puts it in a graph.

Source: E. Westman, M. Kaess, "Degeneracy-aware imaging sonar simultaneous localization and mapping", IEEE Journal of
Oceanic Engineering 45(4), 2020, for the search, the elimination and the singular factor, as re-implemented in the open
code aldoteran/fs-slam. That code leaves elevation out of the linearization and cuts singular values at a fixed number;
here it is eliminated like the rest, and the aperture and the odometry say what is too little.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from factors import Between, SqrtInformation
from factors.keys import Keys
from models import SE3
from models.algebra import Array, Mask
from models.errors import EvaluationError, GraphError, OptionError
from models.options import check_between, is_number
from models.sensors.arcs import Contacts
from nls.missions.sonar.relative_pose import RelativePose, descended

__all__ = ["TwoView", "two_views"]

ROUNDS = 3  # of weights; a fourth changes the pose by less than 1e-2 standard deviations


@dataclass(frozen=True)
class TwoView:
    """The relative pose of the vehicle from two sonar images.

    Attributes
    ----------
    pose : (7,) T = X_i^-1 X_j, SE3, of sonar and odometry together.
    z : (7,) what the sonar alone would have, along the directions it sees; as `pose` along the others.
    information : (6, 6) of the sonar alone, in the frame of pose j, (x, y, z, roll, pitch, yaw); may be singular.
    sqrt_information : (6, 6) W, W'W = information, with a row of zeros for every direction left out.
    gains : (6,) information of the sonar over that of the odometry, along the directions in which they compare, rising.
    directions : (6, 6) these directions, one a row, of one standard deviation of the odometry.
    kept_directions : (6,) which of them are in `information`.
    h : (2, m, 3) range, azimuth and elevation of every point in the first view, both hypotheses, the better one first.
    chi2 : (2, m) of the four measurements of every point, under either.
    ambiguous : (m,) points whose mirror image fits as well: both hypotheses stand.
    weak : (m,) points whose elevation the two views tell worse than the aperture does.
    converged, iterations : whether and when the step fell below 1e-4 standard deviations, 1e-2 where points
        have two hypotheses.
    """

    pose: Array
    z: Array
    information: Array
    sqrt_information: Array
    gains: Array
    directions: Array
    kept_directions: Mask
    h: Array
    chi2: Array
    ambiguous: Mask
    weak: Mask
    converged: bool
    iterations: int

    def factor(self, i: Keys, j: Keys) -> Between:
        """The factor between the two poses: what the sonar said, and nothing else.

        Raises
        ------
        EvaluationError
            The iteration did not converge: there is nothing to rely on.
        """
        if not self.converged:
            raise EvaluationError(
                f"two_views did not converge in {self.iterations} iterations; give it the information of the odometry, "
                "more points, or a better start"
            )
        return Between(i, j, self.z, SqrtInformation(self.sqrt_information))


def two_views(
    z_i: npt.ArrayLike,
    z_j: npt.ArrayLike,
    sigmas: npt.ArrayLike,
    start: npt.ArrayLike,
    limit: float,
    odometry_information: npt.ArrayLike | None = None,
    offset: npt.ArrayLike | None = None,
    tau: float = 1e-3,
) -> TwoView:
    """The relative pose from contacts of the same points in two sonar images.

    Parameters
    ----------
    z_i, z_j : (m, 2) range and azimuth in either image, m and rad, the same point in the same row.
    sigmas : (2,) or (m, 2) of range and azimuth, in both images.
    start : (7,) X_i^-1 X_j by odometry, SE3.
    limit : half the aperture in elevation, rad.
    odometry_information : (6, 6) of `start`, in the frame of pose j; positive definite. Depth and attitude sensors
        belong in it: without them an in-plane motion tells next to nothing. When omitted the start counts for nothing,
        and directions compare by the mean range of the points, for positions, and 1 rad; the mirror image of the whole
        scene then fits as well, and errors of several sigmas are common: the page on degeneracy has the numbers.
    offset : (7,) pose of the sonar on the vehicle; none when omitted.
    tau : directions in which the sonar has less than this part of the odometry's information are left out; when there
        is no odometry, 1: those known worse than the mean range, or 1 rad.

    Returns
    -------
    TwoView

    Raises
    ------
    GraphError
        Shapes that do not fit, no points, sigmas not above 0, an information that is not positive definite.
    OptionError
        A limit or tau that cannot be.
    SingularGeometryError
        A point on the z axis of the second sonar.

    Examples
    --------
    Five points, a heave of half a meter, a start without it:

    >>> import numpy as np
    >>> from models import SE3
    >>> from models.sensors.arcs import second_view
    >>> from nls import kinds
    >>> h = np.array([[4, -0.2, 0.0], [3, 0.1, 0.05], [5, 0.2, 0.1], [4.5, 0.0, -0.05], [3.5, -0.1, 0.08]])
    >>> T = SE3.exp([0.1, 0, 0.5, 0, 0, 0.1])
    >>> seen_again, _ = second_view(T[None], h)
    >>> odometry = np.diag(1 / np.array([0.3, 0.3, 0.3, 0.01, 0.01, 0.05])**2)
    >>> found = two_views(h[:, :2], seen_again, [0.01, 0.004], SE3.exp([0, 0, 0.4, 0, 0, 0]), 0.13, odometry)
    >>> found.converged, found.pose.round(1)[:3]
    (True, array([0.1, 0. , 0.5]))
    >>> x, = kinds("x")
    >>> found.factor(x[0], x[1])
    Between(x0, x1)
    """
    contacts = _contacts(z_i, z_j, sigmas, limit)
    if not is_number(tau) or not 0 < tau <= 1:
        raise OptionError("tau", tau, "a number above 0, at most 1")
    Z = SE3.stack(start)
    O = SE3.identity() if offset is None else SE3.stack(offset)
    if len(Z) != 1 or len(O) != 1:
        raise GraphError("two_views: expected one start (7,) and one offset (7,)")
    if odometry_information is None:
        r = contacts.z[:, 0].mean()
        known, prior, tau = np.diag([r**-2] * 3 + [1.0] * 3), np.zeros((6, 6)), 1.0
    else:
        known = prior = _positive(odometry_information)
    problem = RelativePose(contacts, O[0], Z[0], known, prior)
    T, iterations, converged = descended(problem, Z[0], two_places=False)
    sonar = problem.sonar(T, two_places=True)
    if sonar.arcs.two.any():
        for _ in range(ROUNDS):  # which points have two places is decided once, how much they weigh in every round
            T, more, converged = descended(problem, T, True, sonar.arcs, sonar.N)
            iterations, sonar = iterations + more, problem.sonar(T, True, sonar.arcs)
    gains, directions, rows = _compared(sonar.S, known)
    kept, arcs = gains > tau, sonar.arcs
    W = np.sqrt(np.where(kept, gains, 0.0))[:, None] * rows
    shortest = directions[kept].T @ (directions[kept] @ sonar.g / gains[kept])  # in the metric of the odometry
    return TwoView(
        pose=T,
        z=SE3.retract(T, shortest),
        information=W.T @ W,
        sqrt_information=W,
        gains=gains,
        directions=directions,
        kept_directions=kept,
        h=arcs.h,
        chi2=arcs.chi2,
        ambiguous=arcs.ambiguous,
        weak=arcs.weak,
        converged=converged,
        iterations=iterations,
    )


def _compared(S: Array, known: Array) -> tuple[Array, Array, Array]:
    """S v = w Lambda v: what S says, w (6,) in units of Lambda, and along what: rows v with v' Lambda v = 1.

    The rows r of the third matrix give S = sum of w r r'.
    """
    L = np.linalg.cholesky(known).T
    L_inv = np.linalg.inv(L)
    w, U = np.linalg.eigh(L_inv.T @ S @ L_inv)
    return w, (L_inv @ U).T, U.T @ L


def _contacts(z_i: npt.ArrayLike, z_j: npt.ArrayLike, sigmas: npt.ArrayLike, limit: float) -> Contacts:
    a, b, sigma = (np.asarray(x, dtype=float) for x in (z_i, z_j, sigmas))
    if a.ndim != 2 or a.shape[1] != 2 or a.shape != b.shape or not len(a):
        raise GraphError(f"two_views: z_i {a.shape} and z_j {b.shape}, expected (m, 2) both: the same points in each")
    if sigma.shape not in ((2,), a.shape) or not (sigma > 0).all():
        raise GraphError(f"two_views: sigmas {sigma.shape}, expected (2,) or {a.shape}, above 0: range and azimuth")
    if not (np.isfinite(a).all() and np.isfinite(b).all() and (a[:, 0] > 0).all() and (b[:, 0] > 0).all()):
        raise GraphError("two_views: a range that is not above 0, or a number that is not finite")
    limit = check_between("limit", limit, 0, np.pi / 2, "half the aperture in elevation, rad, between 0 and pi/2")
    W = np.tile(1 / np.atleast_2d(sigma), 2)
    return Contacts(np.concatenate([a, b], axis=1), W[:, :, None] * np.eye(4), limit)


def _positive(information: npt.ArrayLike) -> Array:
    """The information of the odometry, (6, 6), checked."""
    known = np.asarray(information, dtype=float)
    if known.shape != (6, 6) or not np.allclose(known, known.T, rtol=1e-9, atol=0.0):
        raise GraphError(f"two_views: odometry_information has shape {known.shape}, expected (6, 6), symmetric")
    if not np.linalg.eigvalsh(known)[0] > 0:
        raise GraphError(
            "two_views: odometry_information is not positive definite; give every component a sigma, a large one "
            "where nothing is known"
        )
    return known
