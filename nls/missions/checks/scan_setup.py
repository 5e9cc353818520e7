"""Is a scan mission set up as it was sailed? Azimuths, mounting, clock and sigmas.

The result of a check is numbers; `nls.missions.checks.words` makes sentences of them.

Of the sigmas drifts tell most. Steps and closures leave little of their own once drifts have followed them. With all
sigmas of dead reckoning doubled or halved, drifts of a harbor have a chi2 per degree of freedom of 0.36 and 3.3 (1.0 as
stated). Steps have 0.31 and 0.42 (0.47).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factors.keys import kinds
from models import SE2
from models.algebra import Array
from models.errors import GraphError
from nls.analysis.freedom import freedom
from nls.analysis.leave_one_out import checks
from nls.gauge import choose_gauge, fixed_variables
from nls.graph import FactorGraph
from nls.missions.checks.findings import SetupFinding, SetupKind
from nls.missions.checks.scan_mounting import (
    COMPONENTS,
    LIMITS,
    SIGMAS,
    Mounting,
    lateral_drift,
    match_steps,
    mounting,
    turns,
)
from nls.missions.scans.closing import Closing, refuse_other_keyframes, shares
from nls.missions.scans.correlation import match
from nls.missions.scans.matches import WINDOW_BEFORE, comparable, field_before
from nls.missions.scans.scans import Scans
from nls.values import Values

BENDING = frozenset({SetupKind.UNREPEATED, SetupKind.MIRRORED, SetupKind.TIME_OFFSET})  # what follows is no map
LARGEST_SCALE = {"steps": 2.0, "drifts": 1.5, "closures": 2.0}  # times that sigmas may be too large or too small
x, d = kinds("x", "d")


def check_setup(
    graph: FactorGraph, values: Values, scans: Scans, closing: Closing | None = None, times: npt.ArrayLike | None = None
) -> list[SetupFinding]:
    """Faults of the setup, from scans against dead reckoning; `nls.missions.checks.words` makes sentences of it.

    Parameters
    ----------
    graph, values : keyframes x (SE2) and their dead reckoning, see `nls.missions.scans.dead_reckoning`.
    scans : the points, as the assumed mounting places them.
    closing : of them. Without it sigmas are not judged, and a sensor that is turned is seen with half the certainty.
    times : (count,) of the keyframes, s. Without them the clock is not judged.

    Returns
    -------
    list of `SetupFinding`
        Empty where nothing speaks against the setup. Mirrored azimuths, scans of clutter and a late clock bend all that
        follows: nothing else is judged until they are right.

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
    if not estimate.wrong[2] and abs(yaw) > max(SIGMAS * sigma, LIMITS[2]):
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
