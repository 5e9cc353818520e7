r"""Two sonar images of the same points become one factor between two poses: acoustic bundle adjustment of two views.

The unknown is the relative pose T = X_i^-1 X_j of the vehicle, the sonar at G = O^-1 T O. In every iteration each point
is put where its arc fits both images best, linearized with all three of its coordinates, and
eliminated with a truncated block (`truncated_inverse`):

    S = sum A_T' N A_T - A_T' N A_l (A_l' N A_l)^+ A_l' N A_T,      g likewise with b
    (S + Lambda) dT = g + Lambda (start [-] T)                      Lambda: what odometry knows, the metric of S

damped after Levenberg and Marquardt: first with every point at its best place, then with both places where it has two.

The search takes each side of the plane el = 0 by itself (`models.sensors.arcs`). What comes out of the two says which
case a point is:

- *measured*: one side is clearly better, or the minimum lies at 0 itself
- *ambiguous*: a minimum on either side, and their chi2 differ by less than 4; both are kept, never averaged
- *weak*: the two views say less about the elevation than the aperture does, an even spread over 2 limit. Both sides are
  kept, at +-limit / sqrt(3), which has the mean and the variance of that spread

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

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from factors import Between, SqrtInformation
from factors.keys import Keys
from models import SE3
from models.algebra import Array, Mask, apply, dot, gram, product
from models.errors import EvaluationError, GraphError, OptionError, SingularGeometryError
from models.options import check_between, is_number
from models.sensors.arcs import Contacts, least_information
from models.sensors.singular import SingularAt
from nls.linear.schur.inverses import truncated_inverse


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
        """The factor between the two poses, by the sonar alone.

        Raises
        ------
        EvaluationError
            The iteration did not converge: there is nothing to rely on.
        """
        if not self.converged:
            raise EvaluationError(
                f"two_views did not converge in {self.iterations} iterations; give it the information of the odometry, "
                "more points, or a better initial guess"
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
        raise GraphError("two_views: expected one initial guess (7,) and one offset (7,)")
    if odometry_information is None:
        r = contacts.z[:, 0].mean()
        known, prior, tau = np.diag([r**-2] * 3 + [1.0] * 3), np.zeros((6, 6)), 1.0
    else:
        known = prior = _positive(odometry_information)
    problem = RelativePose(contacts, O[0], Z[0], known, prior)
    T, iterations, converged = descended(problem, Z[0], two_places=False)
    sonar = problem.sonar(T, two_places=True)
    if sonar.arcs.two.any():
        # which points have two places is decided once; a fourth round of weights moves the pose by 1e-2 sigmas at most
        for _ in range(3):
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
    """S v = w Lambda v: w (6,), the rows v with v' Lambda v = 1, and rows r with S = sum of w r r'."""
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


@dataclass(frozen=True)
class Arcs:
    """Where the points are, one hypothesis on each side of the plane el = 0, the better one first.

    Attributes
    ----------
    h : (2, m, 3) range, azimuth, elevation.
    chi2 : (2, m) of the four measurements of a point.
    two : (m,) whether both count: ambiguous or weak. Elsewhere the second is only what the other side had to offer.
    ambiguous, weak : (m,) why.
    at_limit : (m,) whether the best elevation there is lies at the end of the aperture.
    """

    h: Array
    chi2: Array
    ambiguous: Mask
    weak: Mask
    at_limit: Mask

    @property
    def two(self) -> Mask:
        return self.ambiguous | self.weak


def search(contacts: Contacts, G: Array, like: Arcs | None = None) -> Arcs:
    """The elevations of lowest chi2 on either side.

    Parameters
    ----------
    contacts : the two images.
    G : (1, 7) motion of the sonar.
    like : where it is decided already which points are ambiguous, and which weak.
    """
    m, limit = len(contacts), contacts.limit
    try:
        h, chi2 = contacts.sides(G)
    except SingularAt as error:
        r, az = contacts.z[error.index, :2]
        raise SingularGeometryError(
            f"the contact at {r:g} m, {az:g} rad, seen from the second view: {error}"
        ) from error
    better = chi2.argmin(axis=0)
    order, points = np.stack([better, 1 - better]), np.arange(m)
    h, chi2 = h[order, points], chi2[order, points]
    size = np.abs(h[:, :, 2])
    if like is None:
        _, A_l, _ = contacts.linearize(G, h[0])
        weak = np.linalg.eigvalsh(gram(A_l))[:, 0] <= least_information(contacts)
        ambiguous = (chi2[1] - chi2[0] < 4.0) & (size > 1e-4 * limit).all(axis=0) & ~weak
    else:
        ambiguous, weak = like.ambiguous, like.weak
    if weak.any():
        spread = h[:, weak].copy()
        spread[:, :, 2] = [[-limit / np.sqrt(3)], [limit / np.sqrt(3)]]
        few = contacts.rows(np.tile(np.flatnonzero(weak), 2))
        moved, spread_chi2, _ = few.fit(G, few.fit(G, spread.reshape(-1, 3))[0])
        h[:, weak], chi2[:, weak] = moved.reshape(spread.shape), spread_chi2.reshape(2, -1)
    return Arcs(h, chi2, ambiguous, weak, (size[0] > (1 - 1e-4) * limit) & ~(ambiguous | weak))


@dataclass(frozen=True)
class Sonar:
    """S (6, 6), g (6,) and chi2 of the sonar alone, with the points and the weights N (m, 4, 4) they were made of."""

    arcs: Arcs
    N: Array
    S: Array
    g: Array
    chi2: float


@dataclass(frozen=True)
class RelativePose:
    """The relative pose T (7,), by the normal equations of the sonar and of the odometry.

    Parameters
    ----------
    contacts : the two images.
    O : (7,) pose of the sonar on the vehicle.
    start : (7,) what the odometry says.
    known : (6, 6) how well, and the metric of T.
    prior : (6, 6) the same where it counts as a measurement, else zeros.
    """

    contacts: Contacts
    O: Array
    start: Array
    known: Array
    prior: Array

    def motion(self, T: Array) -> Array:
        """G (1, 7), of the sonar."""
        return SE3.compose(SE3.inverse(self.O), SE3.compose(T, self.O))[None]

    def sonar(self, T: Array, two_places: bool, arcs: Arcs | None = None, N: Array | None = None) -> Sonar:
        """The sonar at T, each point eliminated; at its best place, or where it has two hypotheses at both.

        Which points have two (as in `arcs`), and the weights N (m, 4, 4), are found anew where they are not given.
        """
        arcs = search(self.contacts, self.motion(T), arcs)
        A_T, A_l, b, weights = self.linearize(arcs, T, two_places)
        N = weights if N is None else N
        stays = arcs.at_limit | (arcs.weak & two_places)  # pressed against the end of the aperture; put where it is
        A_l = np.where(stays[:, None, None], A_l * [1.0, 1.0, 0.0], A_l)
        NA_T, NA_l = product(N, A_T), product(N, A_l)
        H_pp, H_pl, H_ll = product(A_T.mT, NA_T), product(A_T.mT, NA_l), product(A_l.mT, NA_l)
        P = truncated_inverse(H_ll, tau=0.0, floor=least_information(self.contacts))
        g_l = apply(NA_l.mT, b)
        S = (H_pp - product(product(H_pl, P), H_pl.mT)).sum(axis=0)
        g = (apply(NA_T.mT, b) - apply(H_pl, apply(P, g_l))).sum(axis=0)
        chi2 = float((dot(b, apply(N, b)) - dot(g_l, apply(P, g_l))).sum())
        return Sonar(arcs, N, (S + S.T) / 2, g, chi2)

    def linearize(self, arcs: Arcs, T: Array, two_places: bool) -> tuple[Array, Array, Array, Array]:
        """A_T (m, 4, 6), A_l (m, 4, 3), b (m, 4) and N (m, 4, 4) of all points."""
        Ad = SE3.adjoint_inverse(self.O)  # T Exp(d) moves the sonar by G Exp(Ad d)
        G = self.motion(T)
        A_G, A_l, b = self.contacts.linearize(G, arcs.h[0])
        if not (two_places and arcs.two.any()):
            return product(A_G, Ad), A_l, b, np.eye(4)[None]
        B_G, B_l, c = self.contacts.linearize(G, np.where(arcs.two[:, None], arcs.h[1], arcs.h[0]))
        B_l = np.where(arcs.two[:, None, None], B_l * [1.0, 1.0, -1.0], B_l)  # measured away from el = 0
        D, d = product((A_G - B_G) / 2, Ad), ((b - c) / 2)[..., None]
        covariance = np.eye(4) + product(product(D, np.asarray(np.linalg.inv(self.known))), D.mT) + product(d, d.mT)
        return product((A_G + B_G) / 2, Ad), (A_l + B_l) / 2, (b + c) / 2, np.asarray(np.linalg.inv(covariance))

    def normal(self, sonar: Sonar, T: Array) -> tuple[Array, Array, float]:
        """H (6, 6), gradient (6,) and chi2 of sonar and odometry."""
        e = SE3.local(T, self.start)
        J = SE3.jl_inv(e)
        return sonar.S + J.T @ self.prior @ J, sonar.g + J.T @ self.prior @ e, float(sonar.chi2 + e @ self.prior @ e)


def descended(
    problem: RelativePose, T: Array, two_places: bool, arcs: Arcs | None = None, N: Array | None = None
) -> tuple[Array, int, bool]:
    """The pose of lowest chi2 by Levenberg and Marquardt, the iterations, and whether the undamped step became small.

    Undamped steps go to and fro where the range, but for the curvature of the sphere, says nothing about the heave.
    """
    H, g, chi2 = problem.normal(problem.sonar(T, two_places, arcs, N), T)
    # standard deviations; the mean linearization of two hypotheses is not exact: 2e-3 was as far as some got
    lam, small = 1e-3, 1e-2 if two_places else 1e-4
    for iteration in range(most := 50):
        # with a little of the metric, directions that the sonar does not see, without odometry, have no step
        if g @ np.linalg.solve(H + 1e-6 * problem.known, g) < small**2:
            return T, iteration, True
        dT = np.asarray(np.linalg.solve(H + lam * np.diag(np.diag(H) + np.diag(problem.known)), g))
        trial = SE3.retract(T, dT)
        H_trial, g_trial, lower = problem.normal(problem.sonar(trial, two_places, arcs, N), trial)
        if lower <= chi2:
            T, H, g, chi2, lam = trial, H_trial, g_trial, lower, lam / 10
        else:
            lam *= 10
    return T, most, False
