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

**The landmarks of a solved mission**: how well their elevation is known.

The elevation of a landmark is the one in its first view:

    sigma^2 = H Sigma H',    H = [H_X, H_l] of the elevation, Sigma the joint covariance of that pose and landmark

A hinge that pushes is a limit, not a measurement. In Sigma it knows the elevation as well as its softness s, 1 deg,
where chi2 may hardly change over the whole aperture. Here the aperture stands in for it: an even spread over it, seen
from where the landmark was placed, which may be an end; and no elevation is known less well than that:

    v = limit^2 / 3 + elevation^2                                             mean square distance, even spread
    sigma^2  ->  1 / (max(1 / sigma^2 - sum 1 / s^2, 0) + 1 / v)   pushed,    min(sigma^2, v)   not pushed

An arc is no straight line. A sigma that has grown by w adds 3/4 w^2 r^2 along the range, the mean square of r e^2 / 2.
Mean of (error / sigma)^2 of the elevations that are pushed, hull, seeds 0 to 2: 40, 14, 32 by the covariances alone, so
0.7, 0.4, 0.7; e' Sigma^-1 e of their places, 3 expected: 56, 17, 47, so 3.7, 1.4, 2.3.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from factors import Elevation, ElevationHinge, Factor, Isotropic, RangeAzimuth
from factors.keys import Keys, kinds
from factors.noise import square
from factors.sonar import first_contacts
from models import SE3, R
from models.algebra import Array, Index, Mask, Numbers, apply, dot, product
from models.errors import GraphError
from models.sensors import cartesian, spherical
from models.sensors.arcs import second_view
from nls.covariance import Marginals
from nls.graph import FactorGraph
from nls.linear import LinearSolver
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
    other, lowest = np.zeros(len(points)), f(np.zeros((1, len(points))))[0]
    # then sixths of such a step, and 36ths, three to either side of the best so far
    for tried in (np.arange(1, steps + 1), np.arange(-3, 4) / 6, np.arange(-3, 4) / 36):
        size = np.clip(side * other + step * tried[:, None], 0.0, largest)
        grid = side * size
        chi2 = f(grid)
        best = np.argmin(chi2, axis=0)
        better = chi2[best, columns] < lowest
        other = np.where(better, grid[best, columns], other)
        lowest = np.where(better, chi2[best, columns], lowest)
    # the poses have settled with the side that stands, so that the other one is a little worse
    return np.asarray((lowest - f(elevation[None])[0] < 9.0) & (np.abs(other - elevation) > 2.0 * sigma))


FOLLOWS = 1e-3  # rad
x, l, e = kinds("x", "l", "e")


@dataclass(frozen=True)
class Elevations:
    """Landmarks as their first view has them, by their number.

    Attributes
    ----------
    landmarks, poses : (n,) numbers of the landmarks and of the poses that saw them first.
    views : (n,) contacts of each.
    range, azimuth, elevation : (n,) of the estimate, in the frame of the sonar at that pose, m and rad.
    pushed : (n,) whether a hinge keeps the landmark within the aperture, against its measurements.
    sigma : (n,) standard deviation of the elevation, rad; nan where covariances were not asked for, and where the
        landmark is free.
    mirrored : (n,) whether the landmark fits as well with the other sign of the elevation, at a place that sigma does
        not reach; False where there is no sigma. See `nls.missions.sonar.elevation`.
    before : (n,) the same by the covariances alone, before the aperture had its say.
    along : (n, 3) unit vectors of the world: which way the landmark goes as its elevation grows.
    ahead : (n, 3) unit vectors of the world: from the sonar to the landmark.
    """

    landmarks: Numbers
    poses: Numbers
    views: Index
    range: Array
    azimuth: Array
    elevation: Array
    pushed: Mask
    sigma: Array
    mirrored: Mask
    before: Array
    along: Array
    ahead: Array

    def covariances(self, marginals: Marginals) -> Array:
        """Covariances (n, 3, 3) of the landmarks with what the aperture says of them; nan where one is free."""
        known = np.isfinite(self.sigma)
        Sigma = np.full((len(known), 3, 3), np.nan)
        if known.any():
            Sigma[known] = marginals.covariance(l[self.landmarks[known]])
            Sigma[known] = self.bounded(Sigma)[known]
        return Sigma

    def bounded(self, Sigma: Array) -> Array:
        """Covariances (n, 3, 3) of the landmarks along the axes of the world, with what the aperture says of them."""
        was, now = np.square(self.before), np.square(self.sigma)
        grown = np.where(now > was, now - was, 0.0)
        parts = (grown, self.along), (0.75 * grown**2, self.ahead)
        arc, bow = (np.sqrt(k)[:, None] * self.range[:, None] * v for k, v in parts)
        Sh = np.matvec(Sigma, self.along)
        known = np.where(now < was, 1 - np.divide(now, was, out=np.ones_like(now), where=was > 0), 0.0)
        own = dot(self.along, Sh)  # 0 of a landmark that is held
        less = np.sqrt(known / np.where(own > 0, own, 1.0))[:, None] * Sh
        changes = (sign * v[:, :, None] * v[:, None, :] for sign, v in ((1, arc), (1, bow), (-1, less)))
        return np.asarray(Sigma + sum(changes))


def elevations(
    graph: FactorGraph,
    values: Values,
    sigmas: bool = False,
    linear_solver: LinearSolver | None = None,
    gauge: str = "first",
) -> Elevations:
    """The elevation of every landmark of a mission at its first view, and how well it is known.

    Parameters
    ----------
    graph : its `RangeAzimuth` factors; their offset is fixed, or a variable: its uncertainty then counts, too.
    values : poses ``x`` and landmarks ``l``.
    sigmas : whether to compute the standard deviations, from the covariances at these values. What the measurements
        leave free has none.
    linear_solver, gauge : for the covariances, as in `nls.Marginals`.

    Raises
    ------
    UnderconstrainedError
        Sigmas where the measurements leave everything free.
    """
    contacts = [factor for factor in graph.factors if isinstance(factor, RangeAzimuth)]
    pose = np.concatenate([factor.keys[0].numbers for factor in contacts])
    point = np.concatenate([factor.keys[1].numbers for factor in contacts])
    landmarks, views = np.unique(point, return_counts=True)
    first = first_contacts(x[pose], l[point])
    S, p, firsts = np.zeros((len(first), SE3.size)), np.zeros((len(first), 3)), []
    begin = np.cumsum([0, *map(len, contacts)])
    for factor, low, high in zip(contacts, begin[:-1], begin[1:], strict=True):
        rows = np.flatnonzero((first >= low) & (first < high))  # landmarks whose first contact is one of its
        sighting = factor[first[rows] - low]
        assert isinstance(sighting, RangeAzimuth)
        X_keys, l_keys = sighting.keys[:2]
        firsts.append((rows, Elevation(X_keys, l_keys, np.zeros((len(rows), 1)), Isotropic(1.0), sighting.offset)))
        _, X = values.gather(sighting)
        S[rows], p[rows] = sighting.sensor_pose(SE3, X[0], *X[2:]), X[1]
    r, azimuth, elevation = spherical(SE3.act(SE3.inverse(S), p))[0].T
    _, J = cartesian(np.column_stack([r, azimuth, elevation]))
    along = (SE3.rotation(S) @ J[:, :, 2:])[..., 0] / r[:, None]
    sigma = np.full(len(r), np.nan)
    if sigmas:
        sigma = _sigmas(graph, values, firsts, elevation, linear_solver, gauge)
    held = np.concatenate([np.zeros(0, dtype=int), *(keys.numbers for keys in graph.fixed if keys.kind == l.name)])
    hinges, limit = _limits(graph, values, landmarks, held)
    pushed, before, v = hinges > 0, sigma.copy(), limit**2 / 3 + elevation**2
    sigma = np.minimum(sigma, np.sqrt(v))
    sigma[pushed] = 1 / np.sqrt(np.maximum(1 / before[pushed] ** 2 - hinges[pushed], 0.0) + 1 / v[pushed])
    ahead = (p - SE3.position(S)) / r[:, None]
    twofold = np.isfinite(sigma) & ~np.isin(landmarks, held)
    if twofold.any():
        polar = np.column_stack([r, azimuth, elevation])[twofold]
        twofold[twofold] = mirrored(graph, values, l[landmarks[twofold]], S[twofold], polar, sigma[twofold])
    return Elevations(
        landmarks, pose[first], views, r, azimuth, elevation, pushed, sigma, twofold, before, along, ahead
    )


def _limits(graph: FactorGraph, values: Values, landmarks: Numbers, held: Numbers) -> tuple[Array, Array]:
    """Information (n,) of the hinges that push a landmark, 0 for none, and its limit (n,), inf where nothing says.

    A landmark that is held is not pushed: its place is given, and its hinges say something of the poses.
    """
    hinges, limit = np.zeros(len(landmarks)), np.zeros(len(landmarks))
    for factor in graph.factors:
        if isinstance(factor, ElevationHinge):
            W = square(factor.noise.sqrt_information(len(factor), factor.measures))[:, 0, 0]
            numbers = factor.keys[1].numbers
            pushes = (factor.chi2(values) > 0) & ~np.isin(numbers, held)
            rows = np.flatnonzero(np.isin(numbers, landmarks))
            at = np.searchsorted(landmarks, numbers[rows])
            np.add.at(hinges, at, np.where(pushes, np.square(W), 0.0)[rows])
            limit[at] = np.maximum(limit[at], factor.limit)
    return hinges, np.where(limit > 0, limit, np.inf)


def _sigmas(
    graph: FactorGraph,
    values: Values,
    firsts: list[tuple[Index, Elevation]],
    elevation: Array,
    solver: LinearSolver | None,
    gauge: str,
) -> Array:
    """Standard deviations (n,) of the elevations: those of variables e that follow them within `FOLLOWS`; nan: free.

    A variable that only follows adds nothing to what is known of the others, and its variance is H Sigma H' +
    FOLLOWS^2: all of them come out of one pass over the factor of A'A, where the joint covariances of every landmark
    with its pose are nine columns of the inverse each (1,321 landmarks of 2,143 poses: 3 s, not 47).
    """
    followed = [_followed(view, e[rows], values) for rows, view in firsts if len(view)]
    wider = FactorGraph([*graph.factors, *followed], graph.fixed)
    with_elevations = Values.of([*values.stacks.values(), *Values({e: (R(1), elevation[:, None])}).stacks.values()])
    marginals = Marginals(wider, with_elevations, solver, gauge)
    known = np.array(marginals.status(e)) == "estimated"
    sigma = np.full(len(elevation), np.nan)
    sigma[known] = np.sqrt(marginals.covariance(e[np.flatnonzero(known)])[:, 0, 0] - FOLLOWS**2)
    return sigma


def _followed(view: Elevation, keys: Keys, values: Values) -> Factor:
    """Variables that are the elevations of a view, but for `FOLLOWS`."""
    manifolds = values.gather(view)[0].manifolds

    def away(*X: Array) -> Array:
        return view.predict(manifolds, *X[:-1])[0] - X[-1]

    def jacobians(*X: Array) -> list[Array]:
        H = view.predict(manifolds, *X[:-1])[1]
        assert H is not None
        return [*(np.asarray(block) for block in H), np.full((len(view), 1, 1), -1.0)]

    return Factor.from_function(away, [*view.keys, keys], 1, Isotropic(FOLLOWS), jacobians)
