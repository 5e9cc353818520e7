"""Is a scan mission set up as it was sailed? Azimuths, mounting, clock and sigmas.

The result of a check is numbers; `nls.missions.checks.scan_words` makes sentences of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
import numpy.typing as npt

from factors.keys import kinds
from models import SE2
from models.algebra import Array
from nls.graph import FactorGraph
from nls.missions.checks.scan_mounting import COMPONENTS, LIMITS, SIGMAS, Mounting, lateral_drift, mounting
from nls.missions.checks.scan_neighbors import match_steps, steps
from nls.missions.checks.scan_sigmas import fits
from nls.missions.scans.closing import Closing, refuse_other_keyframes
from nls.missions.scans.correlation import match
from nls.missions.scans.matches import WINDOW_BEFORE, comparable, field_before
from nls.missions.scans.scans import Scans
from nls.values import Values

__all__ = ["BENDING", "SetupFinding", "SetupKind", "check_setup"]

TURNING = 100  # steps that are compared with their mirror, those that turn most
TURN = float(np.radians(3.0))  # least turn of such a step
NARROW = (1.0, float(np.radians(3.0)))  # m, rad: its window is narrower than the turn, so that its sense counts
TIMES = 3.0  # as many steps for the mirror as against it: 30 of 40 by chance is one case in 1,000
FEWEST = 10  # steps for the mirror; right setups of the harbor have 94 to 99 of 100 against it
SCANS = 150  # compared with those before them at most, evenly along the track
RECKONED = 0.3  # m, sigma of dead reckoning over the keyframes before a scan
FITS = 3.0  # most e' C^-1 e of a scan that fits where it is reckoned: 78 % of those with right sigmas
FEW_SCANS = 20  # below which nothing is said
SHARE = 0.25  # least share of them: random points have 0.02 to 0.19, harbors 0.34 (one straight wall) to 0.89
x = kinds("x")[0]


class SetupKind(StrEnum):
    """A wrong setup, the identifier that programs get."""

    UNREPEATED = "unrepeated"
    MIRRORED = "mirrored"
    MOUNTING = "mounting"
    TURNED = "turned"
    TIME_OFFSET = "time_offset"
    SIGMAS_TOO_LARGE = "sigmas_too_large"
    SIGMAS_TOO_SMALL = "sigmas_too_small"


BENDING = frozenset({SetupKind.UNREPEATED, SetupKind.MIRRORED, SetupKind.TIME_OFFSET})  # what follows is no map


@dataclass(frozen=True)
class SetupFinding:
    """A wrong setup.

    Attributes
    ----------
    kind : of it.
    numbers : by name, m, rad and s.

        - ``unrepeated``: `scans` that were matched with those just before them, and how many of these `fit`.
        - ``mirrored``: steps that turn and fit better as `given`, and `mirrored`.
        - ``mounting``: `component` x, y or yaw, its `value` and `sigma` from the assumed one, and the `mount` (3,) that
          follows.
        - ``turned``: `value` and `sigma` of the yaw that is missing if nothing drifts sideways, and `mount`.
        - ``time_offset``: `value`, by which the stamps of the scans are late, and `sigma`.
        - ``sigmas_too_large``, ``sigmas_too_small``: `measurements` steps, drifts or closures, `chi2`, `dof`, `scale`
          on the stated sigmas.
    """

    kind: SetupKind
    numbers: Mapping[str, Any]


def check_setup(
    graph: FactorGraph,
    values: Values,
    scans: Scans,
    closing: Closing | None = None,
    times: npt.ArrayLike | None = None,
) -> list[SetupFinding]:
    """Faults of the setup, from scans against dead reckoning; `nls.missions.checks.scan_words` makes sentences of it.

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
        for fit in fits(graph, closing):
            if fit.too_large or fit.too_small:
                kind = SetupKind.SIGMAS_TOO_LARGE if fit.too_large else SetupKind.SIGMAS_TOO_SMALL
                numbers = {"measurements": fit.name, "chi2": fit.chi2, "dof": fit.dof, "scale": fit.scale}
                findings.append(SetupFinding(kind, numbers))
    return findings


def _mirrored(poses: Array, scans: Scans) -> list[SetupFinding]:
    """Azimuths of the wrong sign: scans of consecutive keyframes fit the turn between them better when mirrored.

    A mirrored scan turns against the vehicle. Every step that turns is a witness, also where no loop closes. Closures
    of a first round tell the same on a way that comes back from other headings, 146 accepted against 6 in a harbor. On
    laps they do not: mirrored scans of one heading agree with each other.
    """
    i, turn = steps(poses, scans)
    i = i[np.argsort(-turn, kind="stable")[: min(TURNING, int((turn >= TURN).sum()))]]
    better = match_steps(poses, scans.mirrored(), i, NARROW).score - match_steps(poses, scans, i, NARROW).score
    given, mirrored = int((better < 0).sum()), int((better > 0).sum())
    if not most_are_mirrored(given, mirrored):
        return []
    return [SetupFinding(SetupKind.MIRRORED, {"given": given, "mirrored": mirrored})]


def most_are_mirrored(given: int, mirrored: int) -> bool:
    """Whether azimuths have the wrong sign, by how many steps fit better as given and how many when mirrored."""
    return mirrored >= FEWEST and mirrored > TIMES * given


def _unrepeated(poses: Array, scans: Scans) -> list[SetupFinding]:
    """Scans that show other things from keyframe to keyframe: clutter does, and closes loops by chance.

    Scans are matched with the points of the keyframes just before them, and counted where they fit as reckoned.
    """
    k = comparable(scans)
    k = k[np.unique(np.linspace(0, len(k) - 1, min(len(k), SCANS)).astype(np.intp))] if len(k) else k
    fit = 0
    for row in k.tolist():
        best = match(field_before(poses, scans, row), scans[row], np.zeros(3), WINDOW_BEFORE)
        e = best.pose[:2]
        fit += bool(e @ np.linalg.solve(best.covariance[:2, :2] + RECKONED**2 * np.eye(2), e) < FITS)
    if len(k) < FEW_SCANS or fit >= SHARE * len(k):
        return []
    return [SetupFinding(SetupKind.UNREPEATED, {"scans": len(k), "fit": fit})]


def _mounting(estimate: Mounting, scans: Scans, closing: Closing | None) -> list[SetupFinding]:
    """Wrong components of the mounting; a yaw that only a drift to the side could explain besides."""
    findings = [
        _finding(
            SetupKind.MOUNTING, estimate.value[k], estimate.sigma[k], component=COMPONENTS[k], mount=estimate.mount
        )
        for k in np.flatnonzero(estimate.wrong[:3])
    ]
    yaw, sigma = estimate.lateral if closing is None else lateral_drift(closing.graph, closing.values)
    if not estimate.wrong[2] and abs(yaw) > max(SIGMAS * sigma, LIMITS[2]):
        turned = SE2.compose(np.array([[0.0, 0.0, yaw]]), scans.mount[None])[0]
        findings.append(_finding(SetupKind.TURNED, yaw, sigma, mount=turned))
    return findings


def _finding(kind: SetupKind, value: float, sigma: float, **numbers: object) -> SetupFinding:
    plain = {name: entry.tolist() if isinstance(entry, np.ndarray) else entry for name, entry in numbers.items()}
    return SetupFinding(kind, {"value": float(value), "sigma": float(sigma), **plain})
