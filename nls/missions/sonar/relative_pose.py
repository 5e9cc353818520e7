r"""The relative pose of two sonar views as a least-squares problem, every point on its arc and eliminated.

    S = sum A_T' N A_T - A_T' N A_l (A_l' N A_l)^+ A_l' N A_T,      g likewise with b       the sonar
    H = S + J' Lambda J,   gradient = g + J' Lambda e,   e = start [-] T                     and the odometry

See `nls.missions.sonar.two_view` for A, N and what they are for. `models.sensors.arcs` searches each side of the
plane el = 0 by itself. What comes out of the two says which case a point is:

- *measured*: one side is clearly better, or the minimum lies at 0 itself
- *ambiguous*: a minimum on either side, and their chi2 differ by less than `ALIKE`; both are kept, never averaged
- *weak*: the two views say less about the elevation than the aperture does, an even spread over 2 limit. Both sides are
  kept, at +-limit / sqrt(3), which has the mean and the variance of that spread
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models import SE3
from models.algebra import Array, Mask, apply, dot, gram, product
from models.errors import SingularGeometryError
from models.sensors.arcs import Contacts, least_information
from models.sensors.singular import SingularAt
from nls.linear.schur.inverses import truncated_inverse

ALIKE = 4.0  # chi2: a mirror image within 2 sigmas of the better one is as good
SMALL = 1e-4  # an undamped step, in standard deviations, that ends the descent
MEAN = 1e-2  # the same with both hypotheses, whose mean linearization is not exact: 2e-3 was as far as some got
TINY = 1e-6  # of the metric: directions the sonar does not see, without odometry, have no step
ITERATIONS = 50


@dataclass(frozen=True)
class Arcs:
    """Where the points are, one hypothesis on each side of the plane el = 0, the better one first.

    Attributes
    ----------
    h : (2, m, 3) range, azimuth, elevation.
    chi2 : (2, m) of the four measurements of a point.
    two : (m,) whether both count: ambiguous or weak. Elsewhere the second is only what the other side had to offer.
    ambiguous, weak : (m,) why.
    lowest : (m,) chi2 at the best elevation there is.
    at_limit : (m,) whether that is at the end of the aperture.
    """

    h: Array
    chi2: Array
    ambiguous: Mask
    weak: Mask
    lowest: Array
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
    size, lowest = np.abs(h[:, :, 2]), chi2[0].copy()
    if like is None:
        _, A_l, _ = contacts.linearize(G, h[0])
        weak = np.linalg.eigvalsh(gram(A_l))[:, 0] <= least_information(contacts)
        ambiguous = (chi2[1] - chi2[0] < ALIKE) & (size > 1e-4 * limit).all(axis=0) & ~weak
    else:
        ambiguous, weak = like.ambiguous, like.weak
    if weak.any():
        spread = h[:, weak].copy()
        spread[:, :, 2] = [[-limit / np.sqrt(3)], [limit / np.sqrt(3)]]
        few = contacts.rows(np.tile(np.flatnonzero(weak), 2))
        moved, spread_chi2, _ = few.fit(G, few.fit(G, spread.reshape(-1, 3))[0])
        h[:, weak], chi2[:, weak] = moved.reshape(spread.shape), spread_chi2.reshape(2, -1)
    return Arcs(h, chi2, ambiguous, weak, lowest, (size[0] > (1 - 1e-4) * limit) & ~(ambiguous | weak))


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
        """What the sonar says at T, each point eliminated; at its best place, or where it has two hypotheses at both.

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
    lam = 1e-3
    for iteration in range(ITERATIONS):
        if g @ np.linalg.solve(H + TINY * problem.known, g) < (MEAN if two_places else SMALL) ** 2:
            return T, iteration, True
        dT = np.asarray(np.linalg.solve(H + lam * np.diag(np.diag(H) + np.diag(problem.known)), g))
        trial = SE3.retract(T, dT)
        H_trial, g_trial, lower = problem.normal(problem.sonar(trial, two_places, arcs, N), trial)
        if lower <= chi2:
            T, H, g, chi2, lam = trial, H_trial, g_trial, lower, lam / 10
        else:
            lam *= 10
    return T, ITERATIONS, False
