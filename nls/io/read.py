"""The reader of graph text files of every dialect: from its records to a graph, start values and a report.

Vertices may stand anywhere, in any order, or not at all. Then poses are chained along the edges and points placed where
they were first seen. Nothing is repaired unless asked for: what cannot be right is an error with its line.
"""

from collections import Counter
from collections.abc import Sequence
from functools import partial

import numpy as np

from factors.base import Factor
from factors.between import Between
from factors.between_sensors import BetweenSensors
from factors.conventions import check_convention
from factors.keys import Keys
from factors.noise import Isotropic
from factors.position import Position
from factors.prior import Prior
from factors.robust import DCS, Robust
from factors.sighting import Sighting
from models import SE2, LieGroup
from models.algebra import Array, Index
from models.listing import several
from nls.graph import FactorGraph
from nls.io.dialects import choose
from nls.io.formats import Reading, refuse_needless
from nls.io.ids import Offsets, Roles, Switches, by_role, present
from nls.io.records import (
    KINDS,
    Lines,
    Record,
    among,
    note_rounded,
    note_turns,
    read_lines,
    spaces_of,
)
from nls.io.report import LoadReport, Source, Statement
from nls.io.text import Text, printable
from nls.io.unused_lines import note_comments, set_aside, without_comments
from nls.io.variable_names import id_text, with_letters
from nls.io.weights import matrix, noise_of, repaired
from nls.posegraph import says_poses
from nls.stages import stage
from nls.starts.dead_reckoning import chain
from nls.starts.landmarks import locate_points
from nls.values import OnDemand, Stack, Values

POSE, POINT, MOUNT = KINDS["pose"], KINDS["point"], KINDS["mount"]
NO_VERTICES = "no vertices in the file"
SMALL = 1e60  # measured poses whose numbers add up to less, in absolute value, lead to no infinite one


@np.errstate(over="ignore", invalid="ignore")  # numbers near the largest overflow in the checks, and are then refused
def read_graph(
    data: bytes,
    path: str,
    convention: str = "g2o",
    dialect: str = "auto",
    repair_information: bool = False,
    before: int = 0,
    start: bool = True,
    ignore_tags: Sequence[str] = (),
    drop_absent: bool = False,
) -> tuple[FactorGraph, Values, LoadReport]:
    """Graph, start values and report of the bytes of a graph text file.

    Parameters
    ----------
    data, path : the bytes, and their name for messages.
    convention : residual of pose measurements.
    dialect : one of `nls.io.dialects.TAGGED`, or ``auto``.
    repair_information : replace information matrices with negative eigenvalues by the nearest semi-definite ones.
    before : lines of the file before these bytes.
    start : without vertices, chain the poses; otherwise the values are none, of the spaces that the edges name.
    ignore_tags, drop_absent : as for `nls.load`.

    Raises
    ------
    GraphFileError
        With the line, for anything that cannot be right.
    OptionError
        A repair of information in a dialect that has none; a tag to ignore that is read.
    """
    check_convention(convention)
    with stage("read words"):
        text = Text(data, path, before)
        tags, comments = without_comments(text)
    format, reason = choose(text, tags, comments, dialect, part=not start)
    if format.matrix != "information":
        refuse_needless(path, format.name, Reading(repair_information=repair_information))
    records = {tag: format.tags[tag] for tag in tags if tag in format.tags}
    group = _dimension(text, tags, records)
    report = LoadReport(path, format.name, f"{group.point_dim}-D", convention, reason=reason)
    report.tags = {printable(tag): len(lines) for tag, lines in tags.items()}
    unknown = {t: n for t, n in tags.items() if t not in format.tags and not (format.fix and t == b"FIX")}
    if unknown or ignore_tags:
        known = {t: record.words for t, record in format.tags.items()} | ({b"FIX": 0} if format.fix else {})
        set_aside(text, unknown, known, ignore_tags, report, format.ignored_tags)
    note_comments(report, len(comments))

    lines: dict[bytes, Index] = {}
    for tag, record in records.items():
        others = lines.get(record.tag)
        lines[record.tag] = tags[tag] if others is None else np.sort(np.concatenate([others, tags[tag]]))
    with stage("read numbers"):
        read = [read_lines(text, format.tags[tag], at) for tag, at in lines.items()]
    edges = [block for block in read if block.record.factor is not None]
    vertices = [block for block in read if block.record.factor is None and block.record.slots]
    edges = by_role(format, vertices, edges)
    apart = format.apart or any(block.record.apart for block in edges)
    edges = present(text, vertices, edges, report, apart) if drop_absent else edges
    named = [block for block in read if not block.record.slots]
    offsets = Offsets(text, [block for block in named if not block.record.switched], group)
    switches = Switches(text, [block for block in named if block.record.switched], vertices, edges)
    roles = Roles(text, vertices, edges, unknown, apart)
    factors: list[Factor] = []
    with stage("read factors"):
        for block in edges:
            switched = block.record.switched
            _note_use(block, report)
            noises = _matrices(text, block, format.matrix, repair_information, report)
            parameters = switches if switched else offsets
            for mine in switches.kinds_of(block, report) if switched else roles.kinds_of(block):
                factors.append(_factor(block, mine, noises, format.matrix, parameters, roles, group, report))
                report.sources.append(Source(path, text.first_number + block.at[mine]))
    graph = FactorGraph(factors)
    if len(roles.vertex_ids):
        values = _vertex_values(vertices, roles, group)
    else:
        report.vertices_given = False
        spaces, ids = {kind: spaces_of(group)[role] for role, kind in KINDS.items()}, roles.all_ids()
        values = Values.of(Stack(k, spaces[k], spaces[k].identity(len(n)), n) for k, n in ids.items() if len(n))
        values = started(factors, roles, values, group, report) if start else values.spaces()
    note_rounded(report, read)
    note_turns(report, vertices, edges)
    offsets.keep_unused(report)
    switches.keep_unused(report)
    if format.fix and b"FIX" in tags:
        graph.fixed += _fixed(text, tags[b"FIX"], roles, records)
    return with_letters(graph, values, report, roles.all_ids())


def _dimension(text: Text, tags: dict[bytes, Index], records: dict[bytes, Record]) -> LieGroup:
    """SE2 or SE3, whichever the file is about; parameters alone say it where there is nothing else."""
    records = {t: r for t, r in records.items() if r.slots} or records
    groups = {record.group for record in records.values()}
    if len(groups) == 2:
        line = max(min(int(tags[t][0]) for t, r in records.items() if r.group is group) for group in groups)
        raise text.error("mixes poses of the plane and of space; expected one dimension in a file", line)
    return next(iter(groups), SE2)


def _matrices(text: Text, block: Lines, entries: str, repair: bool, report: LoadReport) -> Array:
    """Matrices (n, m, m) of the lines of an edge, as the file has them, repaired where that was asked for."""
    M = matrix(block.record, block.numbers[:, block.record.element.width :], entries)
    if repair:
        M, changed = repaired(M)
        if changed.any():
            count, tag = int(changed.sum()), block.record.tag.decode()
            line = text.first_number + block.at[np.argmax(changed)]
            matrices, were, noun = ("matrices", "were", "ones") if count > 1 else ("matrix", "was", "one")
            report.warn(
                f"{count} information {matrices} of {tag} had negative eigenvalues, first on line {line}, and {were} "
                f"replaced by the nearest semi-definite {noun}"
            )
            rows, columns = block.record.places
            width = block.record.element.width
            block.numbers[:, width : width + len(rows)] = M[:, rows, columns]
    return M


def _factor(
    block: Lines,
    mine: Index | slice,
    matrices: Array,
    entries: str,
    offsets: Offsets | Switches,
    roles: Roles,
    group: LieGroup,
    report: LoadReport,
) -> Factor:
    """One batch of measurements of these lines."""
    record, at, convention = block.record, block.at[mine], report.convention
    keys = [Keys(roles.kind(slot, ids[mine]), ids[mine]) for slot, ids in zip(record.slots, block.ids, strict=True)]
    z, numbers = block.X[mine], block.numbers[mine]
    all_offsets = offsets.of(block)[mine] if record.parameters else np.zeros((len(at), 0, group.size))
    M = matrices[mine] * all_offsets[:, :, 1:2] ** 2 if record.switched else matrices[mine]
    with roles.text.at_lines(at):
        noise = noise_of(record, entries, M, numbers[:, : record.element.width], convention)
        if isinstance(offsets, Switches):
            noise = Robust(noise, DCS(float(offsets.phi[mine][0])))
        shared: list[Array] = []
        if record.parameters or record.element.angles or record.foreign or block.link_types.size:
            report.statements.append(
                Statement(noise, record.tag, convention, z, numbers, block.parameters[mine], all_offsets)
            )
            columns = [all_offsets[:, k] for k in range(record.parameters)]
            shared = [O[:1] if (O == O[0]).all() else O for O in columns]
        factor = record.build(keys, z, noise, shared, convention)
        factor.bind(*(spaces_of(group)[slot] for slot in record.slots))
    return factor


def _vertex_values(vertices: list[Lines], roles: Roles, group: LieGroup) -> Values:
    """The file's vertices as values, in the order of the file."""
    stacks: dict[str, Stack] = {}
    for block in vertices:
        (slot,) = block.record.slots
        for mine in roles.kinds_of(block, slot):
            ids = block.ids[0][mine]
            kind = roles.kind("either" if slot == "pose" else slot, ids)
            stacks[kind] = Stack(kind, block.record.element.space, block.X[mine], ids)
    return Values.of(stacks[kind] for kind in KINDS.values() if kind in stacks)


def _note_use(block: Lines, report: LoadReport) -> None:
    record, name = block.record, block.record.tag.decode()
    if not (record.used or record.switched):
        report.notes.append(f"{name} lines name a parameter that their error does not use")
    if record.foreign and record.factor is Position:
        report.notes.append(f"{name} lines of poses are read as positions")
    if block.link_types.size:
        named = ", ".join(f"{kind:g} ({count})" for kind, count in sorted(Counter(block.link_types[:, 0]).items()))
        report.warn(f"{name} lines end in a type of a link, {named}: not used, and only a g2o file gets it back")


def _fixed(text: Text, lines: Index, roles: Roles, records: dict[bytes, Record]) -> list[Keys]:
    """The variables of all FIX lines, each once."""
    count = text.first[lines + 1] - text.first[lines] - 1
    text.refuse(count == 0, lines, lambda _: "FIX without a vertex; expected FIX id [id ...]")
    owner = np.repeat(lines, count)
    numbers = text.whole(owner, 1 + np.concatenate([np.arange(n) for n in count]))
    kinds = roles.all_ids()
    both = among(numbers, np.intersect1d(roles.poses, roles.points))
    text.refuse(both, owner, lambda k: f"FIX {numbers[k]} may mean the pose or the point of this number")
    missing = ~np.isin(numbers, np.concatenate(list(kinds.values())))
    if missing.any():
        k = int(np.argmax(missing))
        has_vertices = len(roles.vertex_ids) > 0
        named = " or ".join(t.decode() for t, r in records.items() if (r.factor is None) == has_vertices and r.slots)
        which = f"which no {named} line has; add one, or take {numbers[k]} out"
        raise text.error(f"FIX names vertex {id_text(numbers[k])}, {which}", int(owner[k]))
    fixed = [Keys(kind, np.unique(numbers[np.isin(numbers, ids)])) for kind, ids in kinds.items()]
    return [keys for keys in fixed if len(keys)]


def started(factors: list[Factor], roles: Roles, values: Values, group: LieGroup, report: LoadReport) -> Values:
    """Vertices the edges name, all at the identity, where the measurements say; poses are chained when asked for.

    Raises
    ------
    GraphFileError
        A point that its measurements do not place; poses beyond the largest number.
    """
    small = all(isinstance(factor, Between) and np.abs(factor.z).sum() < SMALL for factor in factors)
    for factor in factors:
        if isinstance(factor, Prior):  # a pose, place or point that is known
            known = factor.z if factor.offset is None else group.compose(factor.z, group.inverse(factor.offset))
            values[factor.keys[0]] = known
    if len(roles.poses):
        steps = FactorGraph([step for factor in factors for step in _pose_steps(factor, values, group)])
        values = OnDemand(values, partial(chain, steps)) if small else chain(steps, values)
        report.notes.append(f"{NO_VERTICES}: {several(len(roles.poses), 'pose')} chained along the edges")
    if len(roles.points):
        values = _placed(factors, roles, values)
        report.notes.append(f"{NO_VERTICES}: {several(len(roles.points), 'point')} placed by the measurements")
    if count := len(roles.mounts):
        places = "1 place of a sensor begins" if count == 1 else f"{count} places of sensors begin"
        report.notes.append(f"{NO_VERTICES}: {places} at the vehicle's own")
    if not small and not all(np.isfinite(stack.X).all() for stack in values.stacks.values()):
        line = min(int(block.at[0]) for block in roles.edges)
        raise roles.text.error("the poses chained along the edges grow beyond the largest number", line)
    return values


def _pose_steps(factor: Factor, values: Values, group: LieGroup) -> list[Factor]:
    """A measured difference of poses as one of the vehicles: O z O^-1 where a sensor at an estimated place O saw it."""
    if says_poses(factor):
        return [factor] if factor.keys[0].kind == POSE else []
    if not isinstance(factor, BetweenSensors):
        return []
    i, j, mount = factor.keys
    O = values[mount]
    return [Between(i, j, group.compose(group.compose(O, factor.z), group.inverse(O)), Isotropic())]


def _placed(factors: list[Factor], roles: Roles, values: Values) -> Values:
    """Points from a prior, else from where they were seen, else along measured differences of points."""
    before = values.stack(POINT)
    prior = [f.keys[0].numbers for f in factors if isinstance(f, Prior) and f.keys[0].kind == POINT]
    sightings = FactorGraph([f for f in factors if isinstance(f, Sighting)])
    joined = FactorGraph([f for f in factors if isinstance(f, Between) and f.keys[0].kind == POINT])
    for numbers in prior:
        sightings.fix(Keys(POINT, numbers))
    try:
        values = locate_points(sightings, values)
    except np.linalg.LinAlgError as error:
        line = min(int(block.at[0]) for block in roles.edges)
        raise roles.text.error(f"numbers too large to place the points ({error}); give vertices", line) from error
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
        message = f"no vertices, and the measurements do not say where point {id_text(lost[0])} is; add vertices"
        raise roles.text.error(message, roles.first_line(("point",), int(lost[0])))
    return values
