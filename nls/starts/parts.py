"""Parts of a graph: some of its measurements, over the variables they touch, with some of these held."""

from collections.abc import Sequence

import numpy as np

from factors.base import Factor
from factors.keys import Keys
from models.algebra import Mask
from nls.gauge import fixed_of
from nls.graph import FactorGraph
from nls.values import Values

Masks = dict[str, Mask]  # per kind (n,), in the order of its stack


class Parts:
    """A graph from which parts are taken.

    Parameters
    ----------
    graph, values : the whole, and every variable.

    Attributes
    ----------
    factors : those of the graph.
    index : per factor and slot the rows (n,) of the stack.
    fixed : what the graph holds fixed.
    """

    def __init__(self, graph: FactorGraph, values: Values) -> None:
        self.factors: list[Factor] = graph.factors
        self.index = [tuple(values.stack(keys.kind).index(keys) for keys in f.keys) for f in graph.factors]
        self.fixed = {kind: fixed_of(graph.fixed, stack) for kind, stack in values.stacks.items()}

    def any(self, k: int, mask: Masks) -> Mask:
        """Measurements (n,) of factor k that touch a variable of the mask, whose kinds may be some of all."""
        touched = np.zeros(len(self.factors[k]), dtype=bool)
        for keys, index in zip(self.factors[k].keys, self.index[k], strict=True):
            if keys.kind in mask:
                touched |= mask[keys.kind].take(index)
        return touched

    def take(self, measurements: Sequence[Mask], held: Masks, values: Values) -> tuple[FactorGraph, Values]:
        """Wanted measurements (n,) of every factor, and the values of what they touch; held and fixed ones are fixed.

        A factor from a function, whose data only the function knows, comes as a whole.
        """
        subgraph, touched = FactorGraph(), {kind: np.zeros(len(s), dtype=bool) for kind, s in values.stacks.items()}
        for factor, index, rows in zip(self.factors, self.index, measurements, strict=True):
            if not rows.any():
                continue
            whole = rows.all() or factor.opaque
            subgraph.add(factor if whole else factor[rows])
            for keys, places in zip(factor.keys, index, strict=True):
                touched[keys.kind][places if whole else places[rows]] = True
        stacks = []
        for kind, mask in touched.items():
            if mask.any():
                stack = values.stack(kind)
                stacks.append(stack.only(mask))
                still = mask & (self.fixed[kind] | held[kind] if kind in held else self.fixed[kind])
                if still.any():
                    subgraph.fix(Keys(kind, stack.numbers[still]))
        return subgraph, Values.of(stacks)


def put_back(values: Values, solution: Values, fixed: Sequence[Keys] = ()) -> Values:
    """Values with those of a solution for some of them; fixed variables stay as they are, bit for bit."""
    X = {}
    for kind, estimates in solution.stacks.items():
        stack = values.stack(kind)
        X[kind] = np.array(stack.X)
        X[kind][stack.index(Keys(kind, estimates.numbers))] = estimates.X
    for keys in fixed:
        held = values.stack(keys.kind).index(keys)
        X[keys.kind][held] = values.stack(keys.kind).X[held]
    return values.replaced(X)
