r"""The ids in the lines of a file: roles of vertices, fixed poses of sensors, and switches.

Vertices are poses, points or places of sensors, by vertex lines and by the slots of edges. Edges name parameters, fixed
poses of sensors or switches, besides vertices.

Switchable edges of vertigo are read as closures under the kernel `factors.robust.DCS`. A switch s scales the residual
of its edge, and a prior keeps it near a value gamma, with information xi:

    s^2 chi2 + xi (gamma - s)^2,   that is with u = s / gamma   u^2 (gamma^2 chi2) + gamma^2 xi (1 - u)^2

Dynamic covariance scaling states the switch in closed form, u = min(1, 2 phi / (phi + chi2)), where phi is the
information of the prior: here phi = gamma^2 xi, and the information of the edge times gamma^2. So no switch is a
variable, and its start value counts for nothing. Lines of switches are kept for `nls.save`.

Sources: N. Suenderhauf, P. Protzel, "Switchable constraints for robust pose graph SLAM", IROS 2012, and the types of
its program vertigo; P. Agarwal et al., "Robust map optimization using dynamic covariance scaling", ICRA 2013.
"""

from collections.abc import Iterator, Mapping

import numpy as np

from models import LieGroup
from models.advice import Advice
from models.algebra import Array, Index, Numbers
from models.listing import several, some
from nls.io.records import KINDS, NONE, Dialect, Lines, among, by_number, different, joined
from nls.io.report import LoadReport
from nls.io.text import Text, printable
from nls.io.unused_lines import keep
from nls.io.variable_names import id_text

ROLE_NAMES = {"pose": "pose", "point": "point", "mount": "place of a sensor"}
VERTEX, PRIOR = b"VERTEX_SWITCH", b"EDGE_SWITCH_PRIOR"


def by_role(format: Dialect, vertices: list[Lines], edges: list[Lines]) -> list[Lines]:
    """The edges, with lines of a tag for points apart that are about poses, where the format has a record of these."""
    of_poses = {r.tag: r for r in format.records if r.foreign and r.slots == ("either",)}
    out: list[Lines] = []
    for block in edges:
        if record := of_poses.get(block.record.tag):
            is_pose = among(block.ids[0], different(_ids(vertices or edges, "pose")))
            parts = block.only(~is_pose, block.record), block.only(is_pose, record)
            out += [part for part in parts if len(part.at)]
        else:
            out.append(block)
    return out


def present(text: Text, vertices: list[Lines], edges: list[Lines], report: LoadReport, apart: bool) -> list[Lines]:
    """The edges without those to vertices that no line gives, which are kept as text; all of them without vertices."""
    if not vertices:
        return edges
    given = [
        different(joined(v.ids[0] for v in vertices if not apart or (v.record.slots == ("point",)) == point))
        for point in (False, True)
    ]
    masks = [
        np.all([among(i, given[s == "point"]) for s, i in zip(b.record.slots, b.ids, strict=True)], axis=0)
        for b in edges
    ]
    if len(absent := np.sort(joined(block.at[~mask] for block, mask in zip(edges, masks, strict=True)))):
        count, line = several(len(absent), "edge"), text.first_number + absent[0]
        report.warn(f"{count} to vertices that no line gives left out, first on line {line}")
        keep(text, absent, report)
    return [block.only(mask, block.record) for block, mask in zip(edges, masks, strict=True) if mask.any()]


def _ids(lines: list[Lines], slot: str) -> Numbers:
    """Ids in all slots of this name."""
    return joined([i for block in lines for s, i in zip(block.record.slots, block.ids, strict=True) if s == slot])


class Roles:
    """The vertices of a file by what they are, checked against every edge.

    Parameters
    ----------
    text, vertices, edges : the file, and its lines by record.
    unknown : its lines (from 0) by tags that are not known.
    apart : whether a pose and a point may have one number.

    Attributes
    ----------
    vertex_ids : ids of all vertex lines; empty when the file has none.
    poses, points, mounts : ids of each role.

    Raises
    ------
    GraphFileError
        A vertex given twice, used as two things, or missing while others are there.
    """

    def __init__(
        self, text: Text, vertices: list[Lines], edges: list[Lines], unknown: Mapping[bytes, Index], apart: bool = False
    ) -> None:
        self.text, self.edges, self.unknown = text, edges, unknown
        parts = [[block] for block in vertices] if apart else [vertices]
        self.vertex_ids = different(joined([by_number(text, part, "vertex")[0] for part in parts]))
        self.mounts, lines = different(_ids(edges, "mount")), vertices or edges
        self.points = different(_ids(lines, "point"))
        self.poses = different(joined([_ids(lines, "pose"), _ids(lines, "either")]))  # and mounts
        if vertices:
            self._refuse_missing({block.record.slots[0]: block for block in vertices}, apart)
        self._refuse_clash("pose", self.mounts, "mount")
        for slot in () if apart or vertices else ("pose", "mount", "either"):
            self._refuse_clash(slot, self.points, "point")
        self.poses = self.poses[~among(self.poses, self.mounts)]

    def all_ids(self) -> dict[str, Numbers]:
        """Ids by kind of variable."""
        return {KINDS["pose"]: self.poses, KINDS["point"]: self.points, KINDS["mount"]: self.mounts}

    def kind(self, slot: str, ids: Numbers) -> str:
        """Kind of the variables of a slot whose ids are all of one role."""
        if slot == "either":
            slot = "mount" if among(ids[:1], self.mounts).all() else "pose"
        return KINDS[slot]

    def kinds_of(self, block: Lines, slot: str = "either") -> Iterator[Index | slice]:
        """The lines of an edge or vertices, apart where this slot of theirs holds variables of two kinds."""
        if slot not in block.record.slots or not len(self.mounts):
            yield slice(None)
            return
        mount = among(block.ids[block.record.slots.index(slot)], self.mounts)
        for mine in (np.flatnonzero(~mount), np.flatnonzero(mount)):
            if len(mine):
                yield mine

    def first_line(self, slots: tuple[str, ...], number: int) -> int:
        """First line (from 0) that uses a vertex in one of these slots; -1 when none does."""
        lines = [
            int(block.at[np.argmax(ids == number)])
            for block in self.edges
            for slot, ids in zip(block.record.slots, block.ids, strict=True)
            if slot in slots and (ids == number).any()
        ]
        return min(lines, default=-1)

    def _refuse_clash(self, slot: str, claimed_ids: Numbers, role: str) -> None:
        """Refuse vertices in slots of this name that are something else in other lines."""
        if not len(claimed_ids):
            return
        used = _ids(self.edges, slot)
        clash = used[np.isin(used, claimed_ids)]
        if len(clash):
            number = int(clash[0])
            line, other_line = self.first_line((slot,), number), self.first_line((role,), number)
            use, other_use = ROLE_NAMES.get(slot, "pose"), ROLE_NAMES[role]
            if line < other_line:
                line, other_line, use, other_use = other_line, line, other_use, use
            message = f"vertex {id_text(number)} is used as {use} here, and as {other_use} on line {other_line + 1}"
            raise self.text.error(message, line)

    def _refuse_missing(self, lines: dict[str, Lines], apart: bool) -> None:
        """Refuse an edge to a vertex that no line gives, or that is of another role."""
        for block in self.edges:
            for slot, ids in zip(block.record.slots, block.ids, strict=True):
                role = "point" if slot == "point" else "pose"
                known, other_role = (self.points, "pose") if role == "point" else (self.poses, "point")
                if (is_known := among(ids, known)).all():
                    continue
                k = int(np.argmin(is_known))
                if not apart and other_role in lines and (ids[k] == lines[other_role].ids[0]).any():
                    line = int(lines[other_role].at[np.argmax(lines[other_role].ids[0] == ids[k])])
                    message = f"the edge needs a {role}, vertex {id_text(ids[k])} is a {other_role} (line {line + 1})"
                    raise self.text.error(message, int(block.at[k]))
                tag = lines[role].record.tag.decode() if role in lines else f"{role} vertex"
                self._refuse_unknown(int(ids[k]), int(block.at[k]), tag)
                raise self.text.error(
                    f"the edge needs vertex {id_text(ids[k])}, which no {tag} line has (others are there); add it, or "
                    "remove all vertices: poses are then chained along the edges",
                    int(block.at[k]),
                    [Advice("drop absent")],
                )

    def _refuse_unknown(self, number: int, edge: int, tag: str) -> None:
        """Refuse the first line with an unknown tag that may give the vertex an edge needs."""
        text = self.text
        for line in np.sort(np.concatenate([[], *self.unknown.values()])).astype(np.intp).tolist():
            head, behind = text.first[line : line + 2].tolist()
            if behind > head + 1 and text.token(head + 1) == b"%d" % number:
                word = printable(text.token(head), 40)
                raise text.error(
                    f"the edge on line {edge + 1} needs vertex {number}, which no {tag} line has; this line may mean "
                    f"it, but '{word}' is no tag",
                    line,
                )


class Offsets:
    """Fixed poses of sensors on the vehicle."""

    def __init__(self, text: Text, lines: list[Lines], group: LieGroup) -> None:
        self.text, self.group = text, group
        self.others = joined([block.at for block in lines if block.record.group is not group])
        lines = [block for block in lines if block.record.group is group]
        self.ids, order = by_number(text, lines, "parameter")
        self.X = np.concatenate([group.identity(0), *(block.X for block in lines)])[order]
        self.at = joined([block.at for block in lines])[order]
        self.unused = np.ones(len(self.ids), dtype=bool)

    def of(self, block: Lines) -> Array:
        """Offsets (n, k, size) the lines of an edge name."""
        ids, no_line = block.parameters, f"which no PARAMS_{self.group.name}OFFSET line has"
        missing = ~among(ids, self.ids)
        self.text.refuse(
            np.any(missing, axis=1), block.at, lambda k: f"the edge needs parameter {ids[k][missing[k]][0]}, {no_line}"
        )
        index = np.searchsorted(self.ids, ids)
        self.unused[index] = False
        return self.X[index]

    def keep_unused(self, report: LoadReport) -> None:
        """Keep the parameters no edge names as text: a graph has no place for them."""
        _keep(self.text, joined([self.at[self.unused], self.others]), "parameter", " that no edge uses", report)


class Switches:
    """The switches of a file, their priors, and the edges that they are of.

    Parameters
    ----------
    text, lines : the file, and its lines of switches and priors.
    vertices, edges : its other lines by record; numbers of switches are no numbers of vertices.

    Attributes
    ----------
    rows : (n, 1, 3) start value, prior value and information of the switch of every switchable edge.
    phi : (n,) the parameters of their kernels.

    Raises
    ------
    GraphFileError
        A switch or prior given twice or missing; a prior that is not above 0; one switch of two edges.
    """

    def __init__(self, text: Text, lines: list[Lines], vertices: list[Lines], edges: list[Lines]) -> None:
        self.text, self.lines, self.named = text, lines, NONE
        if starts := [block for block in lines if block.record.tag == VERTEX]:
            by_number(text, [*vertices, *starts], "vertex")
        for block in (block for block in edges if block.record.switched):
            self.named = block.parameters[:, 0]
            self.rows = np.hstack([self._of(block, tag) for tag in (VERTEX, PRIOR)])[:, None]
            _, gamma, xi = self.rows[:, 0].T
            self.phi: Array = gamma * gamma * xi
            good = (gamma > 0) & (self.phi > 0) & (0 < self.phi**2) & (self.phi**2 < np.inf)
            if not good.all():
                k = int(np.argmin(good))
                says = f"value {gamma[k]:g} and information {xi[k]:g}; expected two numbers above 0"
                raise text.error(f"the prior of switch {self.named[k]} has {says}", int(block.at[k]))
            text.once(self.named, block.at, "a kernel weighs one edge alone: an edge of switch ")

    def _of(self, block: Lines, tag: bytes) -> Array:
        """The numbers (n, k) of the lines with a tag that belong to the switches of an edge."""
        name, lines = tag.decode(), [other for other in self.lines if other.record.tag == tag]
        ids, order = by_number(self.text, lines, name)
        problem = f"for itself alone, which no {name} line gives; add one"
        missing = ~among(self.named, ids)
        self.text.refuse(missing, block.at, lambda k: f"the edge needs switch {self.named[k]} {problem}")
        return np.asarray(np.concatenate([other.X for other in lines])[order[np.searchsorted(ids, self.named)]])

    def of(self, block: Lines) -> Array:
        """Values (n, 1, 3) of the switches that the lines of an edge name."""
        return self.rows[: len(block.at)]

    def kinds_of(self, block: Lines, report: LoadReport) -> list[Index]:
        """The lines of an edge apart by the parameter of their kernel, which a note states."""
        order = np.argsort(self.phi, kind="stable")
        parts = np.split(order, 1 + np.flatnonzero(np.diff(self.phi[order])))
        kernels = some([f"dcs:{self.phi[part[0]]:g} ({len(part)})" for part in parts])
        name = block.record.tag.decode()
        only = "by the priors of their switches, which only a g2o file gets back"
        report.notes.append(f"{name} lines are closures under {kernels}, {only}")
        return parts

    def keep_unused(self, report: LoadReport) -> None:
        """Keep lines of switches and priors that no edge names as text."""
        named = np.sort(self.named)
        lines = joined(block.at[~among(block.ids[0], named)] for block in self.lines)
        _keep(self.text, lines, "line", " of switches that no edge uses", report)


def _keep(text: Text, lines: Index, noun: str, why: str, report: LoadReport) -> None:
    """Keep lines of parameters as text, and say so in a note."""
    if len(lines):
        report.notes.append(f"{several(len(lines), noun)}{why}")
        keep(text, np.sort(lines), report)
