r"""The parameters of a file, which edges name besides vertices: fixed poses of sensors, and switches.

Switchable edges of vertigo are read as closures under the kernel `factors.robust.DCS`. A switch s scales the residual
of its edge, and a prior keeps it near a value gamma, with information xi:

    s^2 chi2 + xi (gamma - s)^2,   that is with u = s / gamma   u^2 (gamma^2 chi2) + gamma^2 xi (1 - u)^2

Dynamic covariance scaling states the switch in closed form, u = min(1, 2 phi / (phi + chi2)), where phi is the
information of the prior: here phi = gamma^2 xi, and the information of the edge times gamma^2. So no switch is a
variable, and its start value counts for nothing. Lines of switches are kept for `nls.save`.

Sources: N. Suenderhauf, P. Protzel, "Switchable constraints for robust pose graph SLAM", IROS 2012, and the types of
its program vertigo; P. Agarwal et al., "Robust map optimization using dynamic covariance scaling", ICRA 2013.
"""

from __future__ import annotations

import numpy as np

from models import LieGroup
from models.algebra import Array, Index
from models.listing import several, some
from nls.io.records import NONE, Lines, among, by_number, joined
from nls.io.report import LoadReport
from nls.io.text import Text
from nls.io.unused_lines import keep

VERTEX, PRIOR = b"VERTEX_SWITCH", b"EDGE_SWITCH_PRIOR"


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
        parameters = block.parameters
        missing = ~among(parameters, self.ids)

        def problem(k: int) -> str:
            number = parameters[k][missing[k]][0]
            return f"the edge needs parameter {number}, which no PARAMS_{self.group.name}OFFSET line has"

        self.text.refuse(np.any(missing, axis=1), block.at, problem)
        index = np.searchsorted(self.ids, parameters)
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
