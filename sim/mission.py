r"""Simulated sonar missions, made from a track and the landmarks in sight.

    XYH          z = h(x_t, x_t+1) + v     steps in x, y and heading, levelled
    ZPR          z = h(x_t) + v            depth, pitch and roll
    contacts     z = h(x_i, l_k) + v       range and azimuth, wherever the sonar sees a landmark
    anchor       x, y and yaw of x_0, exact

v ~ N(0, Sigma); a range below 0 is reflected at 0 (`sim.world.reflected`). The start uses none of the contacts for the
poses: it is the first pose and the odometry chained from there. Each landmark is at elevation 0 of its first contact.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import radians

import numpy as np

from factors import XYH, ZPR, Diagonal, Heading, Isotropic, Position, RangeAzimuth, sonar_factors
from factors.sonar import refuse_search
from models import SE3, R, euler
from models.algebra import Array, Index, Mask, distance_along, wrap
from models.errors import GraphError
from models.sensors import ImagingSonar, levelled, range_azimuth, zpr
from nls import FactorGraph, Keys, Values, kinds
from nls.starts import dead_reckoning, first_sighting
from sim.checks import check_not_negative, check_rng
from sim.world import Simulated, reflected, seed_of

__all__ = ["Mission", "rebuilt", "visible"]

SIGMA_XYH = np.array([0.01, 0.01, radians(0.25)])  # a step: x and y, m, heading, rad
SIGMA_ZPR = np.array([0.01, radians(0.1), radians(0.1)])  # z, m, pitch and roll, rad
SIGMA_SONAR = np.array([0.01, radians(0.25)])  # range, m, azimuth, rad
FEWEST = 3  # contacts of a landmark; what was seen less often is left out
ANCHOR_XY, ANCHOR_YAW = 1e-3, 1e-4  # m and rad: sigmas of the known first pose
SOFTNESS = radians(1.0)  # of the hinge that keeps elevations in the aperture


@dataclass(frozen=True)
class Mission(Simulated):
    """A simulated sonar mission together with its answer.

    Attributes
    ----------
    name : of the function that made it.
    truth : the true poses, kind ``x`` in SE3, and landmarks, kind ``l`` in R(3), both numbered from 0.
    graph : ``graph.factors`` are, in this order, `XYH`, `ZPR`, the anchor (`Position`, then `Heading`) and the contacts
        (`RangeAzimuth`). Last comes `ElevationHinge`, `Elevation` or nothing.
    start : dead reckoning, and landmarks at elevation 0 of their first contact.
    sonar : window, fan and aperture.
    offset : (7,) pose of the sonar on the vehicle.
    elevation : ``free``, ``hinge`` or ``prior``, see `factors.sonar_factors`.
    wrong : (contacts,) which contacts are wrong on purpose, in the order of `contacts`.
    seed : the whole number the generator was made from; None where it was made in another way.
    description : what the mission is, in sentences with the numbers.
    """

    sonar: ImagingSonar
    offset: Array = field(repr=False)
    elevation: str
    wrong: Mask = field(repr=False)
    seed: int | None
    description: str

    @property
    def odometry(self) -> XYH:
        """The steps in x, y and heading."""
        return self.measured(0, XYH)

    @property
    def attitude(self) -> ZPR:
        """Depth, pitch and roll of every pose."""
        return self.measured(1, ZPR)

    @property
    def contacts(self) -> RangeAzimuth:
        """The sonar contacts of the landmarks."""
        return self.measured(4, RangeAzimuth)

    @property
    def distance(self) -> float:
        """Length of the true path, m."""
        return float(distance_along(SE3.position(self.truth.stack("x").X))[-1])

    @property
    def sensed(self) -> FactorGraph:
        """The measurements that have the noise their weights state: odometry, attitude and the contacts not wrong."""
        return FactorGraph([self.odometry, self.attitude, self.contacts[np.flatnonzero(~self.wrong)]])

    @property
    def rows(self) -> int:
        """Measured numbers in `sensed`: the expected chi2 of these at the truth."""
        odometry, attitude, contacts = self.sensed.factors
        return 3 * len(odometry) + 3 * len(attitude) + 2 * len(contacts)


def survey(
    name: str,
    rng: np.random.Generator,
    X: Array,
    points: Array,
    sonar: ImagingSonar,
    offset: Array,
    elevation: str,
    noise_scale: float,
    description: str,
) -> Mission:
    """A mission from the true poses, the points there are, and the sonar that looks for them.

    Parameters
    ----------
    name : of the mission.
    rng : source of the noise.
    X : (n, 7) true poses.
    points : (m, 3) candidates, m; those with three contacts or more become landmarks, in this order.
    sonar, offset : the sonar and its pose (7,) on the vehicle.
    elevation : ``free``, ``hinge`` or ``prior``.
    noise_scale : factor on the drawn noise; 0 gives exact measurements with unchanged weights.
    description : sentences; the counts and the noise are added here.

    Raises
    ------
    OptionError
        No such treatment of the elevation; a scale below 0.
    GraphError
        No point is seen often enough.
    """
    check_rng(rng)
    refuse_search(elevation)
    check_not_negative(noise_scale=noise_scale)
    x, l = kinds("x", "l")
    i, k = visible(X, points, sonar, offset)
    often = np.bincount(k, minlength=len(points)) >= FEWEST
    i, k, points = i[often[k]], (np.cumsum(often) - 1)[k[often[k]]], points[often]
    if not len(points):
        raise GraphError(
            f"{name}: none of {len(often)} points is seen {FEWEST} times from {len(X)} poses; make the way or the "
            "aperture larger, or the points more"
        )
    step, n = np.arange(len(X) - 1), len(X)

    def noisy(h: Array, sigmas: Array, *angles: int) -> Array:
        z = h + noise_scale * sigmas * rng.standard_normal(h.shape)
        z[:, angles] = wrap(z[:, angles])
        return z

    xyh = noisy(levelled(X[:-1], X[1:])[0], SIGMA_XYH, 2)
    tilt = noisy(zpr(X)[0], SIGMA_ZPR, 1, 2)
    p = SE3.act(SE3.inverse(SE3.compose(X, offset[None]))[i], points[k])
    z = noisy(range_azimuth(p)[0], SIGMA_SONAR, 1)
    z[:, 0] = reflected(z[:, 0])
    first = euler.from_se3(X[:1])
    graph = FactorGraph(
        [
            XYH(x[step], x[step + 1], xyh, Diagonal(SIGMA_XYH)),
            ZPR(x[0:n], tilt, Diagonal(SIGMA_ZPR)),
            Position(x[0], first[:, 3:5], Isotropic(ANCHOR_XY), components=("x", "y")),
            Heading(x[0], first[:, 2], Isotropic(ANCHOR_YAW)),
            *sonar_factors(x[i], l[k], z, Diagonal(SIGMA_SONAR), sonar, offset, elevation, SOFTNESS),
        ]
    )
    truth = Values({x: (SE3, X), l: (R(3), points)})
    sentences = (
        f"{description} {n} poses, {len(points)} landmarks seen three times or more, {len(i)} contacts. Sonar: range "
        f"{sonar.window[0]:g} to {sonar.window[1]:g} m, {np.degrees(sonar.fan):g} deg wide, "
        f"{np.degrees(sonar.aperture):g} deg high. Standard deviations: steps 0.01 m and 0.25 deg of heading; depth "
        "0.01 m, pitch and roll 0.1 deg; range 0.01 m, azimuth 0.25 deg"
        f"{'' if noise_scale == 1 else f', drawn {noise_scale:g} times as large'}. The first pose is known."
    )
    wrong = np.zeros(len(i), dtype=bool)
    return Mission(name, truth, graph, _start(graph, truth), sonar, offset, elevation, wrong, seed_of(rng), sentences)


def visible(X: Array, points: Array, sonar: ImagingSonar, offset: Array) -> tuple[Index, Index]:
    """Pairs (i, k): pose i of X (n, 7) has point k of points (m, 3) in its sonar; by pose, then by point.

    Examples
    --------
    >>> from models.sensors import DIDSON_HIGH
    >>> ahead, above = [3.0, 0.0, 0.0], [3.0, 0.0, -2.0]
    >>> visible(SE3.identity(2), np.array([above, ahead]), DIDSON_HIGH, SE3.identity()[0])
    (array([0, 1]), array([1, 1]))
    """
    from scipy.spatial import cKDTree

    S = SE3.compose(X, offset[None])
    ahead, radius = _ball(sonar)
    middle = SE3.act(S, np.array([[ahead, 0.0, 0.0]]))
    reach = cKDTree(middle).sparse_distance_matrix(cKDTree(points), radius, output_type="coo_matrix")
    i, k = reach.row, reach.col
    visible = sonar.sees(SE3.act(SE3.inverse(S)[i], points[k]))
    i, k = i[visible].astype(np.intp), k[visible].astype(np.intp)
    order = np.lexsort((k, i))
    return i[order], k[order]


def _ball(sonar: ImagingSonar) -> tuple[float, float]:
    """The smallest ball that holds all a sonar can see: how far ahead its center is, and its radius, m.

    That of the cone around the view, cos(alpha) = cos(fan/2) cos(aperture/2): through its apex and rim where it is
    narrow, through the rim alone above 45 deg; above 90 deg the sphere of the farthest range.
    """
    far, c = sonar.window[1], float(np.cos(sonar.fan / 2) * np.cos(sonar.aperture / 2))
    if c <= 0:
        return 0.0, far
    return (far / (2 * c), far / (2 * c)) if c * c > 0.5 else (far * c, far * float(np.sqrt(1 - c * c)))


def rebuilt(
    mission: Mission,
    odometry: XYH | None = None,
    contacts: RangeAzimuth | None = None,
    wrong: Mask | None = None,
    note: str = "",
) -> Mission:
    """The mission with other odometry or other contacts: landmarks without contacts leave it, the start is made anew.

    Parameters
    ----------
    mission : not changed.
    odometry, contacts : in place of those it has.
    wrong : which of the contacts are wrong.
    note : a sentence that is added to the description.
    """
    odometry = mission.odometry if odometry is None else odometry
    contacts = mission.contacts if contacts is None else contacts
    wrong = mission.wrong if wrong is None else wrong
    pose, target = contacts.keys[:2]
    sighted = sonar_factors(
        pose, target, contacts.z, contacts.noise, mission.sonar, mission.offset, mission.elevation, SOFTNESS
    )
    graph = FactorGraph([odometry, *mission.graph.factors[1:4], *sighted])
    x, l = mission.truth.stack("x"), mission.truth.stack("l")
    observed = np.isin(l.numbers, target.numbers)
    truth = Values({"x": (SE3, x.X, x.numbers), "l": (R(3), l.X[observed], l.numbers[observed])})
    note = f"{mission.description} {note}".strip()
    return replace(mission, truth=truth, graph=graph, start=_start(graph, truth), wrong=wrong, description=note)


def _start(graph: FactorGraph, truth: Values) -> Values:
    """Dead reckoning from the first true pose, landmarks at elevation 0 of their first contact."""
    x, l = truth.stack("x"), truth.stack("l")
    unknown = truth.replaced({"x": np.repeat(x.X[:1], len(x), axis=0), "l": np.zeros(l.X.shape)})
    known = FactorGraph(graph.factors)
    known.fix(Keys("x", x.numbers[:1]))
    return first_sighting(graph, dead_reckoning(known, unknown))
