"""Start values for a file without vertices: poses chained along its edges, points where they were first seen."""

from __future__ import annotations

import numpy as np

from factors.base import Factor
from factors.between import Between
from factors.between_sensors import BetweenSensors
from factors.keys import Keys
from factors.noise import Isotropic
from factors.prior import Prior
from factors.sighting import Sighting
from models import LieGroup
from models.listing import several
from nls.graph import FactorGraph
from nls.io.gtsam_keys import id_text
from nls.io.lines import Lines
from nls.io.records import KINDS, spaces_of
from nls.io.report import LoadReport
from nls.io.roles import Roles
from nls.io.text import Text
from nls.posegraph import says_poses
from nls.starts.dead_reckoning import chain
from nls.starts.landmarks import locate_points
from nls.values import Values

POSE, POINT, MOUNT = KINDS["pose"], KINDS["point"], KINDS["mount"]
NO_VERTICES = "no vertices in the file"


def started(text: Text, bound: list[tuple[Factor, Lines]], roles: Roles, group: LieGroup, report: LoadReport) -> Values:
    """Values of every vertex the edges name.

    Raises
    ------
    GraphFileError
        A point that its measurements do not place; poses beyond the largest number.
    """
    spaces = {kind: spaces_of(group)[role] for role, kind in KINDS.items()}
    values = Values({k: (spaces[k], spaces[k].identity(len(n)), n) for k, n in roles.all_ids().items() if len(n)})
    for factor, _ in bound:
        if isinstance(factor, Prior):  # a pose, place or point that is known
            known = factor.z if factor.offset is None else group.compose(factor.z, group.inverse(factor.offset))
            values[factor.keys[0]] = known
    if len(roles.poses):
        values = chain(FactorGraph([b for factor, _ in bound for b in _pose_steps(factor, values, group)]), values)
        report.notes.append(f"{NO_VERTICES}: {several(len(roles.poses), 'pose')} chained along the edges")
    if len(roles.points):
        values = _placed(text, bound, roles, values)
        report.notes.append(f"{NO_VERTICES}: {several(len(roles.points), 'point')} placed by the measurements")
    if count := len(roles.mounts):
        places = "1 place of a sensor begins" if count == 1 else f"{count} places of sensors begin"
        report.notes.append(f"{NO_VERTICES}: {places} at the vehicle's own")
    if not all(np.isfinite(stack.X).all() for stack in values.stacks.values()):
        line = int(min(block.at.min() for _, block in bound))
        raise text.error("the poses chained along the edges grow beyond the largest number", line)
    return values


def unstarted(roles: Roles, group: LieGroup) -> Values:
    """No values, of the kinds that the edges name."""
    spaces, ids = spaces_of(group), roles.all_ids()
    return Values({k: (spaces[role], spaces[role].identity(0), []) for role, k in KINDS.items() if len(ids[k])})


def _pose_steps(factor: Factor, values: Values, group: LieGroup) -> list[Factor]:
    """A measured difference of poses as one of the vehicles: O z O^-1 where a sensor at an estimated place O saw it."""
    if says_poses(factor):
        return [factor] if factor.keys[0].kind == POSE else []
    if not isinstance(factor, BetweenSensors):
        return []
    i, j, mount = factor.keys
    O = values[mount]
    return [Between(i, j, group.compose(group.compose(O, factor.z), group.inverse(O)), Isotropic())]


def _placed(text: Text, bound: list[tuple[Factor, Lines]], roles: Roles, values: Values) -> Values:
    """Points from a prior, else from where they were seen, else along measured differences of points."""
    before = values.stack(POINT)
    prior = [f.keys[0].numbers for f, _ in bound if isinstance(f, Prior) and f.keys[0].kind == POINT]
    sightings = FactorGraph([f for f, _ in bound if isinstance(f, Sighting)])
    joined = FactorGraph([f for f, _ in bound if isinstance(f, Between) and f.keys[0].kind == POINT])
    for numbers in prior:
        sightings.fix(Keys(POINT, numbers))
    try:
        values = locate_points(sightings, values)
    except np.linalg.LinAlgError as error:
        line = int(min(block.at.min() for _, block in bound))
        raise text.error(f"numbers too large to place the points ({error}); give vertices", line) from error
    moved = (values.stack(POINT).X != before.X).any(axis=1)
    complete = [f.keys[1].numbers for f in sightings.factors if isinstance(f, Sighting) and f.locates]
    located_ids = np.concatenate([before.numbers[moved], *prior, *complete])
    if joined.factors:
        if len(located_ids):
            joined.fix(Keys(POINT, np.unique(located_ids)))
        values = chain(joined, values)
        located_ids = np.concatenate([located_ids, *(keys.numbers for f in joined.factors for keys in f.keys)])
    lost = roles.points[~np.isin(roles.points, located_ids)]
    if len(lost):
        raise text.error(
            f"no vertices, and the measurements do not say where point {id_text(lost[0])} is; add vertices",
            roles.first_line(("point",), int(lost[0])),
        )
    return values
