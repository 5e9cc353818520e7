"""Several missions of one place as one graph: each dive with its own track, landmarks and beacons in common.

Every dive is read as it is alone. Its poses, and its other own variables, get numbers from 0, 1, 2, ... times the least
power of ten above all numbers. Pose 17 of the second of dives with 900 poses is x1017. Landmarks ``l`` and beacons
``b`` keep their numbers: the same number is the same thing.

A dive without anchor.csv and fixes.csv is placed by the landmarks and beacons that it shares with placed ones. It is
moved in the horizontal, and turned about the vertical where no compass measures its heading. That is a start, not a
measurement. Nothing anchors it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path

import numpy as np

from factors.base import Factor
from factors.keys import Keys, Kind, kinds
from models import SE3, euler
from models.algebra import Array
from models.alignment import align
from models.errors import GraphFileError
from nls.graph import FactorGraph
from nls.io.variable_names import with_keys
from nls.missions.folder.acoustic import refuse_moved_beacons, without_known_beacons
from nls.missions.folder.calibration import Calibrations, Spaces
from nls.missions.folder.columns import LEVEL
from nls.missions.folder.fixes import closures
from nls.missions.folder.folder import MissionReport
from nls.missions.folder.read import read_mission
from nls.missions.folder.rows import Assembly
from nls.missions.starts.placing import turn_to
from nls.values import Values

SHARED = ("l", "b")  # landmarks and beacons: the same in all dives
FEW = 50  # shared landmarks; fewer may agree with others by chance
(x,) = kinds("x")
Read = tuple[FactorGraph, Values, MissionReport]


@dataclass(frozen=True)
class Dive:
    """A mission among several: its name, its report, and the numbers of its own variables in the graph of all.

    Attributes
    ----------
    name : of its folder.
    first, end : the number that its pose 0 has, and the first one that is of the next dive.
    report : of its folder.
    """

    name: str
    first: int
    end: int
    report: MissionReport


@dataclass
class DivesReport(MissionReport):
    """The report of several missions as one; a closure between dives is of the one that saw it.

    Attributes
    ----------
    dives : in the order they were given.
    """

    dives: list[Dive] = field(default_factory=list)


def read_dives(folders: Sequence[str | Path], elevation: str = "hinge") -> tuple[FactorGraph, Values, DivesReport]:
    """The graph of several mission folders, its start and a report; see the page on formats.

    Parameters
    ----------
    folders : of the dives, each once.
    elevation : as for `read_mission`.

    Returns
    -------
    graph, values, report : as for `read_mission`, of all dives; the report has that of each.

    Raises
    ------
    GraphFileError
        No mission; a folder twice; dives with other origins on the Earth; landmarks of equal numbers that are not the
        same; numbers too large for so many dives.
    """
    names = _names(folders)
    others = [read_mission(folder, elevation, anchored=False) for folder in folders[1:]]
    alone = not any(report.anchored for _, _, report in others)
    dives = [read_mission(folders[0], elevation, anchored=alone), *others]
    _refuse_unnamed([report for _, _, report in (*others, dives[0])])
    _refuse_other_origins([report for _, _, report in dives])
    _refuse_other_landmarks(dives, names)
    stride = _stride([values for _, values, _ in dives], str(folders[0]))
    report = DivesReport(", ".join(map(str, folders)), "mission", "3-D", "log", vertices_given=False, reason="folders")
    report.plane = dives[0][2].plane
    placed = _placed(dives, names)
    refuse_moved_beacons([(graph, report) for graph, _, report in dives])
    factors: list[Factor] = []
    fixed: list[Keys] = []
    for k, (own, _, own_report) in enumerate(dives):
        first = k * stride
        own = _renumbered(without_known_beacons(own, own_report, factors), first)
        factors += own.factors
        fixed += own.fixed
        report.dive_of += [names[k]] * len(own.factors)
        _add_report(report, own_report, Dive(names[k], first, first + stride, own_report))
    graph = FactorGraph(factors, fixed)
    values = _together([(values, k * stride) for k, values in placed.items()])
    for k in range(len(dives)):
        _add_closures(graph, report, k, values)
        report.dive_of += [names[k]] * (len(graph.factors) - len(report.dive_of))
    report.truth = _together([(own_report.truth, k * stride) for k, (_, _, own_report) in enumerate(dives)])
    return graph, values, report


def _names(folders: Sequence[str | Path]) -> list[str]:
    """The names of the dives: of their folders.

    Raises
    ------
    GraphFileError
        A folder that is given twice, or has the name of another.
    """
    paths = [Path(folder).resolve() for folder in folders]
    for k, path in enumerate(paths):
        if path in paths[:k]:
            raise GraphFileError("is given twice; every dive counts once", str(folders[k]))
        if path.name in [other.name for other in paths[:k]]:
            raise GraphFileError("has the name of another dive; give each folder a name of its own", str(folders[k]))
    return [path.name for path in paths]


def _refuse_unnamed(reports: Sequence[MissionReport]) -> None:
    """Refuse contacts without names."""
    for report in reports:
        if report.unnamed is not None:
            why = "landmarks of several dives are identified by their numbers"
            cure = "add it, or solve the dives one by one"
            raise report.unnamed.table.at_names(f"has no column 'landmark': {why}; {cure}")


def _refuse_other_origins(reports: Sequence[MissionReport]) -> None:
    """Refuse dives whose x and y are not from one place on the Earth."""
    known = [(report.path, plane) for report in reports if (plane := report.plane) is not None]
    for path, plane in known[1:]:
        if repr(plane) != repr(known[0][1]):
            own, first = (f"{p.lat!r}, {p.lon!r} deg" for p in (plane, known[0][1]))
            cure = "give all dives one origin.csv, and x and y from there"
            message = f"its origin is {own}, that of {known[0][0]} is {first}; {cure}"
            raise GraphFileError(message, str(Path(path, "origin.csv")))


def _refuse_other_landmarks(dives: Sequence[Read], names: Sequence[str]) -> None:
    """Refuse equal numbers of other landmarks: no shift and turn of one dive explains where they are in the other.

    The share of their spread that is left is 0.7 to 1 of 50 other landmarks or more; drift and noise seldom leave half.
    """
    for (k, (_, first, _)), (_, (_, second, report)) in combinations(enumerate(dives), 2):
        p, q = _shared(first, second, SHARED[:1])
        if len(p) < FEW:
            continue
        a, b = p - p.mean(axis=0), q - q.mean(axis=0)
        turned = abs(np.vdot(a @ [1, 1j], b @ [1, 1j]))  # by the best angle
        left = 1 - 2 * turned / (np.square(a).sum() + np.square(b).sum())
        if left > 0.7:
            spread = f"the best shift and turn leaves {100 * left:.0f} % of their spread"
            cure = "give different landmarks different numbers, or solve the dives one by one"
            message = f"{len(p)} of its landmarks have numbers of {names[k]} but other places: {spread}; {cure}"
            raise GraphFileError(message, report.path)


def _stride(starts: Sequence[Values], path: str) -> int:
    """The least power of ten above all numbers that are a dive's own."""
    own = [stack for values in starts for kind, stack in values.stacks.items() if kind not in SHARED and len(stack)]
    largest = max(int(stack.numbers.max()) for stack in own)
    stride = int("1" + "0" * len(str(largest)))
    if stride * len(starts) >= 2**63:
        raise GraphFileError(f"pose {largest} leaves no numbers for other dives; number poses from 0", path)
    return stride


def _renumbered(graph: FactorGraph, first: int) -> FactorGraph:
    """The graph of a dive with its own numbers after a first one."""
    return with_keys(graph, lambda keys: keys if keys.kind in SHARED else Keys(keys.kind, keys.numbers + first))


def _together(parts: Sequence[tuple[Values, int]]) -> Values:
    """Values of all dives, each with the first of its numbers; what several have is taken from the first of them."""
    spaces: Spaces = {}
    for kind in dict.fromkeys(kind for values, _ in parts for kind in values.stacks):
        having = [(values.stacks[kind], first) for values, first in parts if kind in values.stacks]
        stacks = [(stack, 0 if kind in SHARED else first) for stack, first in having]
        X = np.concatenate([np.asarray(stack.X) for stack, _ in stacks])
        numbers, rows = np.unique(np.concatenate([stack.numbers + first for stack, first in stacks]), return_index=True)
        spaces[Kind(kind)] = stacks[0][0].manifold, X[rows], numbers
    return Values(spaces)


def _add_report(report: DivesReport, own: MissionReport, dive: Dive) -> None:
    """Add what a dive holds to the report of all."""
    name, first = dive.name, dive.first
    report.dives.append(dive)
    report.sources += own.sources
    report.findings += [replace(finding, file=f"{name}/{finding.file}") for finding in own.findings]
    report.notes += [f"{name}: {note}" for note in own.notes]
    report.warnings += [f"{name}: {note}" for note in own.warnings]
    report.tags |= {f"{name}/{table}": count for table, count in own.tags.items()}
    report.unmeasured = tuple(dict.fromkeys((*report.unmeasured, *own.unmeasured)))  # of any dive
    if first:
        report.notes.append(f"{name}: pose 0 is x{first}, and so on")
    if own.sonar is not None and report.sonar is None:
        report.sonar, report.offset = own.sonar, own.offset


def _add_closures(graph: FactorGraph, report: DivesReport, k: int, values: Values) -> None:
    """Add what poses of a dive saw of poses of others: the rows of its dive_closures.csv.

    Raises
    ------
    GraphFileError
        A dive that is not given, or is the dive itself; a pose that a dive has not.
    """
    dive, table = report.dives[k], report.dives[k].report.elsewhere
    if table is None:
        return
    others = {other.name: other.first for other in report.dives if other is not dive}
    first, poses = np.zeros(len(table), dtype=np.int64), values.stack(x).numbers
    for row, name in enumerate(table.text_of("dive")):
        if name not in others:
            expected = f"expected one of the others that are solved with it: {', '.join(others)}"
            raise table.at(row, f"dive is {name!r}; {expected}")
        first[row] = others[name]
    numbers = [table.integers("i") + dive.first, table.integers("j") + first]
    for column, poses_of_rows in zip("ij", numbers, strict=True):
        if (missing := ~np.isin(poses_of_rows, poses)).any():
            row = int(np.argmax(missing))
            raise table.at(row, f"{column} is {table.integers(column)[row]}; the track of that dive has no such pose")
    mission = Assembly({}, report, Calibrations(None), {}, graph)
    mission.add_rows(table, np.ones(len(table), dtype=bool), closures(table, x[numbers[0]], x[numbers[1]]))


# --- where a dive is that no file of its own places -------------------------------------------------------------------


def _placed(dives: Sequence[Read], names: Sequence[str]) -> dict[int, Values]:
    """Start values of all dives in one world, by their number; those that files place come first.

    Raises
    ------
    GraphFileError
        A dive that nothing places.
    """
    anchored = {k: values for k, (_, values, report) in enumerate(dives) if report.anchored}
    placed = anchored or {0: dives[0][1]}
    while len(placed) < len(dives):
        world = _together([(values, 0) for values in placed.values()])
        waiting = [k for k in range(len(dives)) if k not in placed]
        k = max(waiting, key=lambda k: len(_shared(dives[k][1], world)[0]))  # it may place others
        _, values, report = dives[k]
        p, q = _shared(values, world)
        if len(p) >= (1 if report.compass else 2):
            x_m, y_m, yaw = np.append(np.mean(q - p, axis=0), 0.0) if report.compass else align(q, p)
            T = euler.to_se3([0.0, 0.0, yaw, x_m, y_m, 0.0])
        elif (closed := _closed(k, dives, names, placed)) is not None:
            pose, target = closed
            _, _, yaw, x_m, y_m, _ = euler.from_se3(target)
            T = turn_to(pose, x_m, y_m, euler.from_se3(pose)[2] if report.compass else yaw)
        else:
            lacks = "it has no anchor.csv and no fixes.csv, no dive_closures.csv connects it to another"
            rest = f"{lacks}, and it shares {len(p)} landmarks and beacons with them; give it one of these files"
            raise GraphFileError(f"its position relative to {names[min(placed)]} is unknown: {rest}", report.path)
        placed[k] = _moved(values, T)
    return placed


def _closed(
    k: int, dives: Sequence[Read], names: Sequence[str], placed: dict[int, Values]
) -> tuple[Array, Array] | None:
    """A pose (7,) of a dive by its own start, and where the first closure with a dive that is placed has it."""
    for one, (_, _, report) in enumerate(dives):
        if (table := report.elsewhere) is None:
            continue
        numbers = np.column_stack([table.integers("i"), table.integers("j")])
        step = table.measured(*LEVEL)
        for row, name in enumerate(table.text_of("dive")):
            other = names.index(name) if name in names else one
            here, there = ((one, 0), (other, 1)) if one == k else ((other, 1), (one, 0))
            keys = [x[int(numbers[row, column])] for _, column in (here, there)]
            if here[0] != k or there[0] not in placed or keys[0] not in dives[k][1] or keys[1] not in placed[there[0]]:
                continue
            z = np.atleast_2d(euler.to_se3([0.0, 0.0, step[row, 2], *step[row, :2], 0.0]))
            state = euler.from_se3(placed[there[0]][keys[1]]).reshape(-1)
            level = np.atleast_2d(euler.to_se3([0.0, 0.0, state[2], *state[3:5], 0.0]))
            return dives[k][1][keys[0]], SE3.compose(level, SE3.inverse(z) if one == k else z)[0]
    return None


def _shared(values: Values, world: Values, kinds: Sequence[str] = SHARED) -> tuple[Array, Array]:
    """Where a dive has the landmarks and beacons that others know, and where these have them: (n, 2) each."""
    p, q = [np.zeros((0, 2))], [np.zeros((0, 2))]
    for kind in kinds:
        if kind in values.stacks and kind in world.stacks:
            own, other = values.stacks[kind], world.stacks[kind]
            _, a, b = np.intersect1d(own.numbers, other.numbers, return_indices=True)
            p.append(np.asarray(own.X)[a, :2])
            q.append(np.asarray(other.X)[b, :2])
    return np.concatenate(p), np.concatenate(q)


def _moved(values: Values, T: Array) -> Values:
    """Poses and points of a dive after a motion (7,)."""
    moved = values.copy()
    for kind, stack in values.stacks.items():
        if stack.manifold is SE3:
            moved[Kind(kind)] = SE3.compose(T, np.asarray(stack.X))
        elif kind in SHARED:
            moved[Kind(kind)] = SE3.act(T, np.asarray(stack.X))
    return moved
