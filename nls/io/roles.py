"""Roles of the vertices of a file, poses, points or places of sensors: by vertex lines and by the slots of edges."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from models.advice import Advice
from models.algebra import Index, Numbers
from models.listing import several
from nls.io.records import KINDS, Dialect, Lines, among, by_number, different, joined
from nls.io.report import LoadReport
from nls.io.text import Text, printable
from nls.io.unused_lines import keep
from nls.io.variable_names import id_text

ROLE_NAMES = {"pose": "pose", "point": "point", "mount": "place of a sensor"}


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
        self.mounts = different(self._used("mount"))
        if len(self.vertex_ids):
            lines = {block.record.slots[0]: block for block in vertices}
            self.points = np.sort(lines["point"].ids[0]) if "point" in lines else self.vertex_ids[:0]
            self.poses = np.sort(lines["pose"].ids[0]) if "pose" in lines else self.vertex_ids[:0]
            self._refuse_missing(lines, apart)
            self._refuse_clash("pose", self.mounts, "mount")
            self.poses = self.poses[~np.isin(self.poses, self.mounts)] if len(self.mounts) else self.poses
        else:
            self.points = different(self._used("point"))
            either = self._used("either")
            self.poses = different(joined([self._used("pose"), either[~among(either, self.mounts)]]))
            self._refuse_clash("pose", self.mounts, "mount")
            for slot in () if apart else ("pose", "mount", "either"):
                self._refuse_clash(slot, self.points, "point")

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

    def _used(self, slot: str) -> Numbers:
        return _ids(self.edges, slot)

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
        used = self._used(slot)
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
                    "take out all vertices to have poses chained along the edges",
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
