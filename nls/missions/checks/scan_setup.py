r"""Is a scan mission set up as it was sailed? Azimuths, mounting, clock and sigmas.

The result of a check is numbers; `nls.missions.checks.words` makes sentences of them.

Of the sigmas drifts tell most. Steps and closures leave little of their own once drifts have followed them. With all
sigmas of dead reckoning doubled or halved, drifts of a harbor have a chi2 per degree of freedom of 0.36 and 3.3 (1.0 as
stated). Steps have 0.31 and 0.42 (0.47).

**The mounting**: where the sensor sits and how late its clock is, from scans of consecutive keyframes against dead
reckoning. The scans were placed on the vehicle with the assumed mounting. With a motion G that takes it to the true
one, scan j as seen from scan i is

    z = (X_i Exp(-w_i c) G)^-1 (X_j Exp(-w_j c) G)

with the twist w of the vehicle by dead reckoning and the time c by which the stamps of the scans are late. This is the
calibration of a sensor against odometry: A. Censi, A. Franchi, L. Marchionni, G. Oriolo, "Simultaneous calibration of
odometry and sensor parameters for mobile robots", IEEE Trans. Robotics 29(2), 2013.

- x and y of G change z by (R(turn) - I) G: a lever arm shows in steps that turn, and in no other.
- yaw of G turns the way of every step, exactly as a drift to the side does. So it is determined as well as that drift.
- c changes z by (w_j - w_i) c: a late clock shows where speed or rate of turn change.

Closures say little of it. The graph follows them to the way of the sensor, and submaps that are built from there agree
with it. With a sensor 1 m off, closures of the third round ask for 0.1 m of it.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from factors import BetweenSensors, Cauchy, Covariance, Diagonal, Isotropic, Prior, Robust, Shifted
from factors.base import Factor
from factors.keys import Keys, kinds
from models import SE2, R
from models.algebra import Array, Index
from models.errors import GraphError
from nls.analysis.clock import central_differences
from nls.analysis.freedom import freedom
from nls.analysis.leave_one_out import checks
from nls.covariance import Marginals
from nls.gauge import choose_gauge, fixed_variables
from nls.graph import FactorGraph
from nls.missions.checks.findings import SetupFinding, SetupKind
from nls.missions.scans.closing import (
    ACCEPTED,
    WINDOW_BEFORE,
    Closing,
    MatchTable,
    comparable,
    field_before,
    refuse_other_keyframes,
    shares,
    verdicts,
)
from nls.missions.scans.correlation import Field, match
from nls.missions.scans.scans import Scans
from nls.values import Values

PRIOR = (2.0, 2.0, float(np.radians(10.0)), 10.0)  # sigmas of x, y, m, yaw, rad, and time, s, before the scans
COMPONENTS = ("x", "y", "yaw", "time")
WRONG_SIGMAS = 3.0  # from the assumed value, above which a component is wrong, where it is by as much as LIMITS
LIMITS = (0.5, 0.5, float(np.radians(3.0)), 0.5)  # m, rad, s: 1 m costs 0.3 m of a map, 1 s all of it
BENDING = frozenset({SetupKind.UNREPEATED, SetupKind.MIRRORED, SetupKind.TIME_OFFSET})  # what follows is no map
LARGEST_SCALE = {"steps": 2.0, "drifts": 1.5, "closures": 2.0}  # times that sigmas may be too large or too small
x, m, d, mount, clock = kinds("x", "m", "d", "scans_mount", "scans_clock_s")


@dataclass(frozen=True)
class Mounting:
    """Where the sensor sits, from the assumed place on, and how late its clock is.

    Attributes
    ----------
    steps : matched scans of consecutive keyframes.
    value, sigma : (4,) x, y, m, yaw, rad, and time, s. nan for a time without stamps.
    sigma_before : (4,) without the scans.
    mount : (3,) assumed pose of the sensor with the correction.
    drift : correlation of yaw with the drift to the side, nan where the graph has no drift m.
    lateral : yaw that is missing if nothing drifts to the side, and its sigma, rad; nan where the graph has no drift m.
    """

    steps: int
    value: Array
    sigma: Array
    sigma_before: Array
    mount: Array
    drift: float
    lateral: tuple[float, float]

    @property
    def share(self) -> Array:
        """(4,) part of the sigma before that is left: 1 where the scans say nothing."""
        return self.sigma / self.sigma_before

    @property
    def determined(self) -> npt.NDArray[np.bool_]:
        """(4,) whether the scans leave less than 0.9 of the sigma before."""
        return np.asarray(self.share <= 0.9)

    @property
    def wrong(self) -> npt.NDArray[np.bool_]:
        """(4,) whether a component is determined, and far from the assumed one: by 3 sigmas, and by what matters."""
        return self.determined & (np.abs(self.value) > np.maximum(WRONG_SIGMAS * self.sigma, LIMITS))


def mounting(graph: FactorGraph, values: Values, scans: Scans, times: npt.ArrayLike | None = None) -> Mounting:
    """Estimate where the sensor sits and how late its clock is.

    Parameters
    ----------
    graph, values : keyframes x (SE2) and their dead reckoning, see `nls.missions.scans.dead_reckoning`.
    scans : as placed by the assumed mounting.
    times : (count,) of the keyframes, s, rising. Without them the clock is taken for right.

    Raises
    ------
    GraphError
        Times that are not one rising number for every keyframe.

    Notes
    -----
    A late clock bends the scans of a vehicle that turns, and with them the mounting: correct it first, and estimate
    again.
    """
    poses = values[x]
    stamps = None if times is None else np.asarray(times, dtype=float)
    shape = (len(poses),)
    if stamps is not None and (stamps.shape != shape or not np.isfinite(stamps).all() or (np.diff(stamps) <= 0).any()):
        expected = f"expected one rising number for each of {len(poses)} keyframes, s"
        raise GraphError(f"times: shape {stamps.shape}; {expected}")
    i, pose, covariance = neighbors(poses, scans)
    start = values.copy()
    start.add(mount, SE2, np.zeros((1, 3)))
    factors: list[Factor] = [*graph.factors, Prior(mount[0], np.zeros((1, 3)), Diagonal(list(PRIOR[:3])))]
    if len(i):
        noise = Robust(Covariance(covariance), Cauchy(2.0))  # some matches of single scans are wrong
        shown: Factor = BetweenSensors(x[i], x[i + 1], pose, noise, mount[0])
        if stamps is not None:
            w = central_differences(SE2, poses, stamps)
            H = shown.predict((SE2, SE2, SE2), poses[i], poses[i + 1], np.zeros((len(i), 3)))[1]
            assert H is not None
            rates = -np.matvec(np.asarray(H[0]), w[i]) - np.matvec(np.asarray(H[1]), w[i + 1])
            shown = Shifted(shown, rates[:, :, None], clock[0])
        factors.append(shown)
    if stamps is not None:
        start.add(clock, R(1), np.zeros((1, 1)))
        factors.append(Prior(clock[0], [[0.0]], Isotropic(PRIOR[3])))
    whole = FactorGraph(factors, graph.fixed)
    result = whole.optimize(start)
    keys = [mount[0], *([m[0]] if _drifts(values) else []), *([clock[0]] if stamps is not None else [])]
    return _read(result.values, Marginals(whole, result.values), keys, len(i), scans)


def lateral_drift(graph: FactorGraph, values: Values) -> tuple[float, float]:
    """The mean drift to the side and its sigma, m for every meter; nan where the graph has no drift m."""
    if not _drifts(values):
        return float("nan"), float("nan")
    sigma = np.sqrt(Marginals(graph, values).covariance(m[0])[1, 1])
    return float(values[m][0, 1]), float(sigma)


def _drifts(values: Values) -> bool:
    """Whether the mean drift m of `dead_reckoning` is among the values."""
    return m.name in values.stacks and values.stack(m).manifold is R(2)


def _read(values: Values, marginals: Marginals, keys: list[Keys], steps: int, scans: Scans) -> Mounting:
    C = marginals.joint(keys, frame="body").matrix
    drifts, timed = m[0] in keys, clock[0] in keys
    G, s = values[mount][0], np.sqrt(np.diagonal(C))
    value, sigma = np.append(G, values[clock][0] if timed else np.nan), np.append(s[:3], s[-1] if timed else np.nan)
    correlation, lateral = float("nan"), (float("nan"), float("nan"))
    if drifts:
        correlation = float(C[2, 4] / (s[2] * s[4]))
        lateral = float(G[2] + values[m][0, 1]), float(np.sqrt(C[2, 2] + C[4, 4] + 2 * C[2, 4]))
    placed = SE2.compose(G[None], scans.mount[None])[0]
    return Mounting(steps, value, sigma, np.array(PRIOR), placed, correlation, lateral)


def neighbors(poses: Array, scans: Scans) -> tuple[Index, Array, Array]:
    """Matched scans of consecutive keyframes, from poses (count, 3); those that are ambiguous are left out.

    Returns
    -------
    i : (n,) keyframes, matched with the next ones j.
    pose : (n, 3) of j in the frame of i, x, y, m, and yaw, rad; of vehicle frames that belong to the assumed mounting.
    covariance : (n, 3, 3) in the frame of j.
    """
    i, window = _chosen(*turns(poses, scans)), (2.0, 0.35)  # m, rad: a clock that is 3 s late at 7 deg/s
    fits = match_steps(poses, scans, i, window)
    good = verdicts(fits.score, fits.ratio, fits.edge, fits.spread, np.full(len(i), window[0])) == ACCEPTED
    return i[good], fits.pose[good], 2 * fits.covariance[good]  # a scan is in two matches


def turns(poses: Array, scans: Scans) -> tuple[Index, Array]:
    """Keyframes i (n,) whose scan and the next one have 30 points, and the turns (n,) to i + 1, rad, 0 or above."""
    enough = np.diff(scans.starts) >= 30
    i = np.flatnonzero(enough[:-1] & enough[1:])
    return i, np.abs(SE2.between(poses[i], poses[i + 1])[:, 2])


def match_steps(poses: Array, scans: Scans, i: Index, window: tuple[float, float]) -> MatchTable:
    """Scans of keyframes i + 1 matched with those of keyframes i (n,), around the steps of poses (count, 3)."""
    S = SE2.between(poses[i], poses[i + 1])
    pairs = zip(i.tolist(), S, strict=True)
    return MatchTable.of([match(Field(scans[k]), scans[k + 1], T, window) for k, T in pairs])


def _chosen(i: Index, turn: Array, half: int = 200) -> Index:
    """Of steps i (n,) half with the largest turns (n,), which show a lever arm and a late clock, half of the rest."""
    if len(i) <= 2 * half:
        return i
    order = np.argsort(-turn, kind="stable")
    rest = np.sort(order[half:])
    return np.sort(i[np.append(order[:half], rest[np.linspace(0, len(rest) - 1, half).astype(np.intp)])])


def check_setup(
    graph: FactorGraph, values: Values, scans: Scans, closing: Closing | None = None, times: npt.ArrayLike | None = None
) -> list[SetupFinding]:
    """Faults of the setup, from scans against dead reckoning; `nls.missions.checks.words` makes sentences of it.

    Parameters
    ----------
    graph, values : keyframes x (SE2) and their dead reckoning, see `nls.missions.scans.dead_reckoning`.
    scans : the points, as the assumed mounting places them.
    closing : of them. Without it sigmas are not tested, and a sensor that is turned is seen with half the certainty.
    times : (count,) of the keyframes, s. Without them the clock is not tested.

    Returns
    -------
    list of `SetupFinding`
        Empty where nothing speaks against the setup. Mirrored azimuths, scans of clutter and a late clock bend all that
        follows: nothing else is tested until they are right.

    Raises
    ------
    GraphError
        Keyframes that are not those of the scans; times that are not one rising number for every keyframe.

    Examples
    --------
    Five scans of one wall close no loop and show no turn: nothing speaks against anything.

    >>> import numpy as np
    >>> from nls.sonar.scans import Scans, check_setup, dead_reckoning
    >>> wall = np.column_stack([np.linspace(5, 15, 40), np.full(40, 4.0)])
    >>> graph, values = dead_reckoning(np.arange(5.0)[:, None] * [1.0, 0.0, 0.0])
    >>> check_setup(graph, values, Scans(np.tile(wall, (5, 1)), np.repeat(np.arange(5), 40), 5))
    []
    """
    refuse_other_keyframes(values, scans)
    if bent := _mirrored(values[x], scans) or _unrepeated(values[x], scans):
        return bent
    estimate = mounting(graph, values, scans, times)
    if estimate.wrong[3]:
        return [_finding(SetupKind.TIME_OFFSET, estimate.value[3], estimate.sigma[3])]
    findings = _mounting(estimate, scans, closing)
    if closing is not None:
        for name, (chi2, dof) in fits(graph, closing).items():
            if kind := doubt_of_sigmas(name, chi2, dof):
                numbers = {"measurements": name, "chi2": chi2, "dof": dof, "scale": (chi2 / dof) ** 0.5}
                findings.append(SetupFinding(kind, numbers))
    return findings


def _mirrored(poses: Array, scans: Scans) -> list[SetupFinding]:
    """Azimuths of the wrong sign: scans of consecutive keyframes fit the turn between them better when mirrored.

    A mirrored scan turns against the vehicle. Every step that turns is a witness, also where no loop closes. Closures
    of a first round tell the same on a way that comes back from other headings, 146 accepted against 6 in a harbor. On
    laps they do not: mirrored scans of one heading agree with each other.
    """
    i, turn = turns(poses, scans)
    narrow = (1.0, float(np.radians(3.0)))  # m, rad: narrower than the turn, so that its sense counts
    i = i[np.argsort(-turn, kind="stable")[: min(100, int((turn >= narrow[1]).sum()))]]
    better = match_steps(poses, scans.mirrored(), i, narrow).score - match_steps(poses, scans, i, narrow).score
    given, mirrored = int((better < 0).sum()), int((better > 0).sum())
    if not most_are_mirrored(given, mirrored):
        return []
    return [SetupFinding(SetupKind.MIRRORED, {"given": given, "mirrored": mirrored})]


def most_are_mirrored(given: int, mirrored: int) -> bool:
    """Whether azimuths have the wrong sign, by how many steps fit better as given and how many when mirrored.

    Right setups of a harbor have 94 to 99 of 100 for the given one; 30 of 40 by chance is one case in 1,000.
    """
    return mirrored >= 10 and mirrored > 3 * given


def _unrepeated(poses: Array, scans: Scans) -> list[SetupFinding]:
    """Scans that show other things from keyframe to keyframe: clutter does, and closes loops by chance.

    Scans are matched with the points of the keyframes just before them, and counted where they fit as reckoned.
    """
    k = comparable(scans)
    k = k[np.unique(np.linspace(0, len(k) - 1, min(len(k), 150)).astype(np.intp))] if len(k) else k
    fit, reckoned = 0, 0.3  # m, sigma of dead reckoning over the keyframes before a scan
    for row in k.tolist():
        best = match(field_before(poses, scans, row), scans[row], np.zeros(3), WINDOW_BEFORE)
        e = best.pose[:2]  # 78 % of those with right sigmas fit
        fit += bool(e @ np.linalg.solve(best.covariance[:2, :2] + reckoned**2 * np.eye(2), e) < 3.0)
    share = 0.25  # random points have 0.02 to 0.19, harbors 0.34 (one straight wall) to 0.89
    if len(k) < 20 or fit >= share * len(k):
        return []
    return [SetupFinding(SetupKind.UNREPEATED, {"scans": len(k), "fit": fit})]


def _mounting(estimate: Mounting, scans: Scans, closing: Closing | None) -> list[SetupFinding]:
    """Wrong components of the mounting; a yaw that only a drift to the side could explain besides."""
    mount, findings = estimate.mount.tolist(), []
    for name, wrong, value, sigma in zip(COMPONENTS[:3], estimate.wrong, estimate.value, estimate.sigma, strict=False):
        if wrong:
            findings.append(_finding(SetupKind.MOUNTING, value, sigma, component=name, mount=mount))
    yaw, sigma = estimate.lateral if closing is None else lateral_drift(closing.graph, closing.values)
    if not estimate.wrong[2] and abs(yaw) > max(WRONG_SIGMAS * sigma, LIMITS[2]):
        turned = SE2.compose(np.array([[0.0, 0.0, yaw]]), scans.mount[None])[0]
        findings.append(_finding(SetupKind.TURNED, yaw, sigma, mount=turned.tolist()))
    return findings


def _finding(kind: SetupKind, value: float, sigma: float, **numbers: object) -> SetupFinding:
    return SetupFinding(kind, {"value": float(value), "sigma": float(sigma), **numbers})


def doubt_of_sigmas(name: str, chi2: float, dof: float) -> SetupKind | None:
    """Whether the stated sigmas of measurements are too large or too small by more than is allowed for.

    With less than 40 degrees of freedom nothing is said: with 40, either limit is one case in 1,000 or less. Steps are
    never too large: their yaw and the compass heading are one number, so small residuals of steps say nothing.
    """
    scale, most = (chi2 / dof) ** 0.5, LARGEST_SCALE[name]
    if dof < 40.0 or 1 / most <= scale <= most or (name == "steps" and scale < 1):
        return None
    return SetupKind.SIGMAS_TOO_LARGE if scale < 1 else SetupKind.SIGMAS_TOO_SMALL


def fits(graph: FactorGraph, closing: Closing) -> dict[str, tuple[float, float]]:
    """chi2 and dof of the steps, of the drifts of stretches, if any, and of the kept closures by their own covariances.

    Degrees of freedom count without what the measurements have spent on the unknowns.

    Parameters
    ----------
    graph : without closures, as `close` took it.
    closing : of it.

    Raises
    ------
    GraphError
        Sigmas that differ too much for a covariance.
    """
    if not closing.matches.kept.any():
        return {}  # dead reckoning agrees with itself
    values = closing.values
    pattern = closing.graph.pattern(values)
    pattern = pattern.holding(choose_gauge("first", pattern, values, fixed_variables(closing.graph.fixed, values)).held)
    checked = freedom(pattern, values).checked
    if checked is None:
        cure = "look for far too small ones"
        raise GraphError(f"check_setup: sigmas of the graph differ too much for a covariance; {cure}")
    parts: dict[str, list[tuple[float, float]]] = {"steps": [], "drifts": [], "closures": []}
    tests = checks(checked, len(pattern.batches))
    for batch, test, e in zip(pattern.batches[: len(graph.factors)], tests, checked.e, strict=False):
        joined = [keys.kind for keys in batch.model.factor.keys]  # keyframes by steps, a drift and the mean by drifts
        if name := "steps" if joined.count(x.name) == 2 else "drifts" if d.name in joined else "":
            parts[name].append((float((e**2).sum()), float(test.dof.sum())))
    kept = closing.matches.kept  # in the last factor
    own = np.square(checked.e[-1]).sum(axis=1) * shares(closing.matches.i[kept], closing.matches.j[kept])
    parts["closures"].append((float(own.sum()), float(tests[-1].dof.sum())))
    return {name: (sum(r[0] for r in rows), sum(r[1] for r in rows)) for name, rows in parts.items() if rows}
