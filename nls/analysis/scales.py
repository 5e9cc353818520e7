r"""Numbers of a kind of measurement that are beyond all others: lengths of relative poses, and informations.

    length_i > 10^6 median(length)                          of all relative poses of a kind
    (W'W)_cc,i > 10^6 max of the others' (W'W)_cc           of a component c; the others are more than half of the kind

A million is no threshold of chance. No vehicle steps a thousand kilometers among steps of a meter, and no sensor is a
thousand times as sharp as its like. Unit mistakes (mm for m, degrees for rad) of one measurement are a thousand times.
"""

from dataclasses import dataclass

import numpy as np

from factors.base import Model
from factors.keys import Keys
from models.algebra import Array, Mask
from nls.sparse.pattern import Pattern

BEYOND = 1e6  # times all others


@dataclass(frozen=True)
class Outsized:
    """One number of a measurement beyond those of all others of its kind.

    Attributes
    ----------
    place : number of the factor, index of the measurement.
    keys : its variables.
    quantity : ``length``, m, or ``information`` of a component.
    component : ``yaw``; empty for a length.
    value : of the measurement.
    reference : median of the kind for a length, the largest of the others for an information.
    """

    place: tuple[int, int]
    keys: tuple[Keys, ...]
    quantity: str
    component: str
    value: float
    reference: float


def outsized(pattern: Pattern) -> tuple[Outsized, ...]:
    """Relative poses and informations beyond all others of their kind by a factor of 10^6.

    Parameters
    ----------
    pattern : of the graph. A kind has one type of factor and the same kinds of variables.

    Returns
    -------
    tuple of Outsized
        In the order of kinds, the largest ratio of each first.

    Examples
    --------
    >>> import numpy as np
    >>> from factors import Between, Isotropic
    >>> from models import SE2
    >>> from nls import Values, kinds
    >>> (x,) = kinds("x")
    >>> z = np.array([[1.0, 0, 0], [1.1, 0, 0], [2e6, 0, 0], [0.9, 0, 0]])
    >>> steps = Between(x[:4], x[1:5], z, Isotropic(0.1))
    >>> [far.place for far in outsized(Pattern([steps], Values({x: (SE2, SE2.identity(5))})))]
    [(0, 2)]
    """
    kinds: dict[tuple[str, ...], list[int]] = {}
    for k, batch in enumerate(pattern.batches):
        if not batch.model.factor.limit_only:
            kinds.setdefault((batch.model.factor.name, *batch.kinds), []).append(k)
    out = []
    for numbers in kinds.values():
        sizes = [len(pattern.batches[k]) for k in numbers]
        factor = np.repeat(numbers, sizes)
        index = np.concatenate([np.arange(size) for size in sizes])
        models = [pattern.batches[k].model for k in numbers]
        columns = [("length", "", np.concatenate([_lengths(model) for model in models]))]
        names = dict.fromkeys(name for model in models for name in model.names)
        informations = [_informations(model, tuple(names)) for model in models]
        columns += [("information", name, column) for name, column in zip(names, np.hstack(informations), strict=True)]
        for quantity, component, values in columns:
            far, reference = _far(values) if quantity == "length" else _beyond(values)
            rows = np.flatnonzero(far)
            for row in rows[np.argsort(-values[rows], kind="stable")].tolist():
                place = int(factor[row]), int(index[row])
                keys = tuple(keys[[place[1]]] for keys in pattern.batches[place[0]].model.factor.keys)
                out.append(Outsized(place, keys, quantity, component, float(values[row]), reference))
    return tuple(out)


def _lengths(model: Model) -> Array:
    """Lengths (n,) of the translations of relative poses; nan of other measurements."""
    names = model.space.components
    if model.factor.frame != "first" or "yaw" not in names:
        return np.full(len(model.z), np.nan)
    return np.asarray(np.linalg.norm(model.z[:, [k for k, name in enumerate(names) if name in {*"xyz"}]], axis=1))


def _informations(model: Model, names: tuple[str, ...]) -> Array:
    """Diagonal of W'W by component, (names, n); nan where a component is not measured."""
    W = model.W
    diagonal = np.square(W) if W.ndim == 2 else np.square(W).sum(axis=1)
    out = np.full((len(names), len(model.z)), np.nan)
    out[[names.index(name) for name in model.names]] = np.broadcast_to(diagonal, (len(model.z), model.dim)).T
    return out


def _far(lengths: Array) -> tuple[Mask, float]:
    """Which lengths are beyond 10^6 times the median, and the median of those above 0, of three at least."""
    positive = lengths[lengths > 0]  # comparisons with nan are False
    median = float(np.median(positive)) if len(positive) > 2 else np.inf
    return lengths > BEYOND * median, median


def _beyond(informations: Array) -> tuple[Mask, float]:
    """Which informations are 10^6 times above all others, and the largest of the others, of three at least.

    The others are more than half; informations of 0 say nothing and are left out.
    """
    known = np.sort(informations[informations > 0])
    gaps = np.flatnonzero(known[1:] > BEYOND * known[:-1])
    gaps = gaps[2 * (gaps + 1) > len(known)]
    largest = float(known[gaps[0]]) if len(known) > 2 and len(gaps) else np.inf
    return informations > BEYOND * largest, largest
