r"""Which landmarks leave with the measurements that are taken out of a graph.

A landmark of d coordinates is determined, the poses held, where its measurements say something in every direction:

    rank of M = d,      M = sum A_l' A_l     over the kept measurements of l that are no limits

Two contacts of an imaging sonar have four numbers for three unknowns, one has two. A landmark that lost measurements
and is no longer determined leaves, with its other measurements and its hinges: nothing checks what is left of it.
A hinge says that a target was in view. It leaves where all measurements of its pose and its landmark do.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from models.algebra import Index, Mask, Numbers
from nls.gauge import fixed_of
from nls.graph import FactorGraph
from nls.starts.landmarks import sees_landmarks
from nls.values import Values


@dataclass(frozen=True)
class Landmarks:
    """The landmarks of a graph.

    Attributes
    ----------
    graph : all measurements.
    doubted : per factor which of its measurements may be taken out.
    factors : per kind of landmarks the factors that touch them: number, slot and the row (n,) of the stack of each
        measurement.
    held : per kind which landmarks are held at their values, and never leave.
    """

    graph: FactorGraph
    doubted: Sequence[Mask]
    factors: dict[str, list[tuple[int, int, Index]]]
    held: dict[str, Mask]

    def kept(self, inliers: list[Mask], values: Values, lost: bool = True) -> list[Mask]:
        """Per factor the inliers without those of landmarks that leave.

        Parameters
        ----------
        inliers : per factor which of its measurements are kept.
        values : at which the Jacobians are taken.
        lost : only landmarks leave that lost a measurement; False: all that are not determined.
        """
        masks = list(inliers)
        for kind, touching in self.factors.items():
            leaves = ~self.held[kind] & ~self._determined(kind, inliers, values)
            if lost:
                out = [d & ~m for d, m in zip(self.doubted, inliers, strict=True)]
                leaves &= self.counts(kind, out) > 0
            if leaves.any():
                for number, _, row in touching:
                    masks[number] = masks[number] & ~leaves[row]
        return self._with_limits(masks)

    def gone(self, inliers: Sequence[Mask]) -> dict[str, Mask]:
        """Per kind which landmarks have no measurement left, of those that had some."""
        every = [np.ones(len(mask), dtype=bool) for mask in inliers]
        return {kind: (self.counts(kind, inliers) == 0) & (self.counts(kind, every) > 0) for kind in self.factors}

    def leaving(self, gone: dict[str, Mask]) -> list[Mask]:
        """Per factor which of its measurements (n,) touch a landmark that is gone."""
        masks = [np.zeros(len(factor), dtype=bool) for factor in self.graph.factors]
        for kind, touching in self.factors.items():
            for number, _, row in touching:
                masks[number] = masks[number] | gone[kind][row]
        return masks

    def present(self, inliers: Sequence[Mask], values: Values) -> Values:
        """The values without the landmarks that are gone."""
        gone = self.gone(inliers)
        if not any(mask.any() for mask in gone.values()):
            return values
        return Values.of(s.only(~gone[s.kind]) if s.kind in gone else s for s in values.stacks.values())

    def counts(self, kind: str, masks: Sequence[Mask]) -> Numbers:
        """How many of some measurements touch every landmark of a kind (n,)."""
        size = len(self.held[kind])
        touching = [row[masks[number]] for number, _, row in self.factors[kind]]
        return np.bincount(np.concatenate(touching), minlength=size)

    def _with_limits(self, masks: list[Mask]) -> list[Mask]:
        """Without the limits of pairs of variables that have lost all their measurements."""
        if not any(factor.limit_only for factor in self.graph.factors):
            return masks
        measured, lost = np.zeros((2, sum(map(len, masks))), dtype=bool)
        for factor, mask, pair in zip(self.graph.factors, masks, self._pairs, strict=True):
            if not factor.limit_only:
                measured[pair[mask]] = lost[pair[~mask]] = True
        limits = zip(self.graph.factors, masks, self._pairs, strict=True)
        return [mask & (measured | ~lost)[pair] if factor.limit_only else mask for factor, mask, pair in limits]

    @cached_property
    def _pairs(self) -> list[Index]:
        """Per factor a number (n,) for the pair of variables that each measurement begins with."""
        kinds = {name: code for code, name in enumerate({key.kind: None for f in self.graph.factors for key in f.keys})}
        ends = [
            np.column_stack([np.broadcast_to([kinds[i.kind], kinds[j.kind]], (len(f), 2)), i.numbers, j.numbers])
            for f in self.graph.factors
            for i, j in [(*f.keys, f.keys[0])[:2]]
        ]
        _, pair = np.unique(np.concatenate(ends), axis=0, return_inverse=True)
        return np.split(pair.reshape(-1), np.cumsum([len(f) for f in self.graph.factors])[:-1])

    def _determined(self, kind: str, inliers: Sequence[Mask], values: Values) -> Mask:
        stack = values.stack(kind)
        d = stack.manifold.dim
        M = np.zeros((len(stack), d, d))
        for number, slot, row in self.factors[kind]:
            factor = self.graph.factors[number]
            if factor.limit_only or not inliers[number].any():
                continue
            rows = np.flatnonzero(inliers[number])
            model, X = values.gather(factor[rows])
            A = model.linearize(*X)[0][slot]
            np.add.at(M, row[rows], A.mT @ A)
        eigenvalues = np.linalg.eigvalsh(M)
        # a millionth in sigmas, far below any second view
        return np.asarray(eigenvalues[:, 0] > 1e-12 * eigenvalues[:, -1])


def landmarks_of(graph: FactorGraph, values: Values, doubted: Sequence[Mask]) -> Landmarks:
    """The landmarks of those kinds that tested measurements observe; none where these see no landmark.

    Examples
    --------
    >>> import numpy as np
    >>> from factors import Isotropic, Range
    >>> from models import SE2, R
    >>> from nls import FactorGraph, Values, kinds
    >>> x, l = kinds("x", "l")
    >>> graph = FactorGraph([Range(x[[0, 1, 0]], l[[0, 0, 1]], [5.0, 4.0, 2.0], Isotropic(0.1))])
    >>> values = Values({x: (SE2, [[0, 0, 0], [3, 0, 0]]), l: (R(2), [[3, 4], [0, 2]])})
    >>> landmarks = landmarks_of(graph, values, [np.array([True, True, False])])
    >>> landmarks.kept([np.array([True, False, True])], values)  # l1 lost nothing
    [array([False, False,  True])]
    """
    pairs = zip(graph.factors, doubted, strict=True)
    kinds = {factor.keys[1].kind for factor, mask in pairs if mask.any() and sees_landmarks(factor, values)}
    factors: dict[str, list[tuple[int, int, Index]]] = {kind: [] for kind in kinds}
    for number, factor in enumerate(graph.factors):
        for slot, keys in enumerate(factor.keys):
            if keys.kind in kinds:
                factors[keys.kind].append((number, slot, values.stack(keys.kind).index(keys)))
    held = {kind: fixed_of(graph.fixed, values.stack(kind)) for kind in kinds}
    return Landmarks(graph, doubted, factors, held)
