r"""Switchable edges of vertigo, read as closures under the kernel `factors.robust.DCS`.

A switch s scales the residual of its edge, and a prior keeps it near a value gamma, with information xi:

    s^2 chi2 + xi (gamma - s)^2,   that is with u = s / gamma   u^2 (gamma^2 chi2) + gamma^2 xi (1 - u)^2

Dynamic covariance scaling states the switch in closed form, u = min(1, 2 phi / (phi + chi2)), where phi is the
information of the prior: here phi = gamma^2 xi, and the information of the edge times gamma^2. So no switch is a
variable, and its start value counts for nothing. Lines of switches are kept for `nls.save`.

Sources: N. Suenderhauf, P. Protzel, "Switchable constraints for robust pose graph SLAM", IROS 2012, and the types of
its program vertigo; P. Agarwal et al., "Robust map optimization using dynamic covariance scaling", ICRA 2013.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from models.algebra import Array, Index, Numbers
from models.listing import several
from nls.io.lines import Lines, among, by_number, joined
from nls.io.report import LoadReport
from nls.io.text import Text
from nls.io.unused_lines import keep

VERTEX, PRIOR = b"VERTEX_SWITCH", b"EDGE_SWITCH_PRIOR"


class Switches:
    """The switches of a file, their priors, and the edges that they are of.

    Parameters
    ----------
    text, lines : the file, and its lines of switches and priors.
    vertices, edges : its other lines by record; numbers of switches are no numbers of vertices.

    Attributes
    ----------
    rows : (n, 1, 3) start value, prior value and information of the switch of every switchable edge.

    Raises
    ------
    GraphFileError
        A switch or prior given twice or missing; a prior that is not above 0; one switch of two edges.
    """

    def __init__(self, text: Text, lines: list[Lines], vertices: list[Lines], edges: list[Lines]) -> None:
        self.text, self.lines = text, lines
        values = [block for block in lines if block.record.tag == VERTEX]
        by_number(text, [*vertices, *values], "vertex")
        self.named, self.rows = np.zeros(0, dtype=np.int64), np.zeros((0, 1, 3))
        for block in edges:
            if block.record.switched:
                self.named = np.sort(block.parameters[:, 0])
                value = self._of(block, VERTEX, values, "1")
                prior = self._of(block, PRIOR, [other for other in lines if other.record.tag == PRIOR], "1 1")
                self.rows = np.hstack([value, prior])[:, None]
                self._refuse(block)

    def _of(self, block: Lines, tag: bytes, lines: list[Lines], example: str) -> Array:
        """The numbers (n, k) of the lines with a tag that belong to the switches of an edge."""
        ids, order = by_number(self.text, lines, f"{tag.decode()} ")
        wanted = block.parameters[:, 0]
        self.text.refuse(
            ~among(wanted, ids),
            block.at,
            lambda k: (
                f"the edge has switch {wanted[k]}, and no {tag.decode()} line says how far it is on; add one, "
                f"such as {tag.decode()} {wanted[k]} {example}"
            ),
        )
        return np.asarray(np.concatenate([other.X for other in lines])[order[np.searchsorted(ids, wanted)]])

    def _refuse(self, block: Lines) -> None:
        wanted, (_, gamma, xi), phi = block.parameters[:, 0], self.rows[:, 0].T, self.phi
        self.text.refuse(
            ~((gamma > 0) & (xi > 0) & (0 < phi * phi) & (phi * phi < np.inf)),
            block.at,
            lambda k: (
                f"the prior of switch {wanted[k]} is {gamma[k]:g} with information {xi[k]:g}; expected two "
                "numbers above 0 whose squares are finite"
            ),
        )
        self.text.once(wanted, block.at, "a kernel weighs one edge alone: an edge of switch ")

    @property
    def phi(self) -> Array:
        """(n,) the parameters of the kernels."""
        return np.asarray(self.rows[:, 0, 1] ** 2 * self.rows[:, 0, 2])

    def of(self, block: Lines) -> Array:
        """Values (n, 1, 3) of the switches that the lines of an edge name."""
        return self.rows[: len(block.at)]

    def kinds_of(self, block: Lines, report: LoadReport) -> Iterator[Index]:
        """The lines of an edge apart by the parameter of their kernel, which a note states."""
        order = np.argsort(self.phi, kind="stable")
        parts = np.split(order, 1 + np.flatnonzero(np.diff(self.phi[order])))
        kernels = [f"dcs:{self.phi[part[0]]:g} ({len(part)})" for part in parts]
        report.notes.append(
            f"{block.record.tag.decode()} lines are edges under the kernel {', '.join(kernels)}, by the priors of "
            "their switches, which only a g2o file gets back"
        )
        yield from parts

    def keep_unused(self, report: LoadReport) -> None:
        """Keep lines of switches and priors that no edge names as text."""
        unused: list[Numbers] = [block.at[~among(block.ids[0], self.named)] for block in self.lines]
        if len(lines := np.sort(joined(unused))):
            tags = "VERTEX_SWITCH or EDGE_SWITCH_PRIOR"
            report.notes.append(f"{several(len(lines), 'line')} {tags} that no edge uses")
            keep(self.text, lines, report)
