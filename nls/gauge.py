"""The gauge: the directions that relative measurements leave free, and their treatment, by name.

- ``first``: fix one variable in every component that has only relative measurements and nothing fixed. It is the
  lowest numbered of the kind with the most degrees of freedom (a pose, where there are poses). It is a point where
  measurements between points know the axes of the world: these determine headings, and a shift alone is free
- ``prior``: give that variable a prior of unit information at its initial value instead
- ``free``: fix nothing and take the shortest step, the one of the pseudo-inverse: |dx| in meters and radians
- ``none``: do nothing; a graph with a free gauge is then refused as under-constrained, but for `Pinv` and the damped
  methods, whose result names what is free

Variables that no factor touches are fixed where they are, with a warning, unless the gauge is ``none``.
"""

import sys
import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from factors.keys import Keys
from factors.noise import Isotropic
from factors.prior import Prior
from models import R
from models.algebra import Index, Mask
from models.errors import GraphWarning, OptionError
from models.listing import some
from nls.sparse.elimination import connected, firsts
from nls.sparse.pattern import Batch, Pattern, once
from nls.values import Stack, Values

OURS = ("models", "factors", "nls", "sim")  # a warning is about the line that called them
GAUGES = ("first", "prior", "free", "none")


class Gauge(NamedTuple):
    """The decision: variables to fix, and the sentence for the report.

    `pattern` is the graph with the priors that were added, nothing held. `fixed` are the held variables that are not
    the gauge: those the user fixed and those no factor touches.
    """

    pattern: Pattern
    held: Mask
    fixed: Mask
    description: str = ""
    free: bool = False


def _moved(batch: Batch) -> list[Index]:
    """Variables (n,) of every slot of a batch that a common motion of everything moves."""
    unmoved = batch.model.factor.unmoved
    return [variables for slot, variables in enumerate(batch.variables) if slot not in unmoved]


@once
def component_labels(pattern: Pattern) -> Index:
    """Connected component (V,) of every variable, named by its first, joined by the factors that see both move.

    A calibration that two trajectories share does not join them: each has its own gauge.
    """
    pairs = [(slots[0], variables) for slots in map(_moved, pattern.batches) for variables in slots[1:]]
    i, j = (np.concatenate([np.zeros(0, dtype=np.intp), *(pair[end] for pair in pairs)]) for end in (0, 1))
    return connected(i, j, len(pattern.dims))


def by_number(pattern: Pattern, kind: str) -> Index:
    """The variables (n,) of a kind, by rising number."""
    return np.asarray(pattern.offsets[kind] + np.argsort(pattern.numbers[kind], kind="stable"))


@once
def calibrations(pattern: Pattern) -> Mask:
    """(V,) variables that a common motion of everything leaves as they are: lenses, drifts, and all joined to these."""
    label, still = component_labels(pattern), np.zeros(len(pattern.dims), dtype=bool)
    for batch in pattern.batches:
        for slot in batch.model.factor.unmoved:
            still[label[batch.variables[slot]]] = True
    return np.asarray(still[label])


def placeless_kinds(pattern: Pattern) -> set[str]:
    """Kinds of variables that are all `calibrations`: they have no place on a map."""
    still = calibrations(pattern)
    return {kind for kind, n in pattern.numbers.items() if len(n) and still[pattern.offsets[kind] :][: len(n)].all()}


def moving_variables(pattern: Pattern) -> Mask:
    """(V,) what moves when everything does: touched by a factor, and no calibration."""
    return touched_variables(pattern) & ~calibrations(pattern)


@once
def touched_variables(pattern: Pattern) -> Mask:
    """(V,) which variables a factor touches."""
    touched = np.zeros(len(pattern.dims), dtype=bool)
    for batch in pattern.batches:
        for variables in batch.variables:
            touched[variables] = True
    return touched


def choose_gauge(name: str, pattern: Pattern, values: Values, fixed: Mask) -> Gauge:
    """Decide how to fix each component that nothing else fixes.

    Parameters
    ----------
    name : one of `GAUGES`.
    pattern, values : the graph with nothing held, and its start.
    fixed : (V,) variables the user fixed.

    Raises
    ------
    OptionError
        No such gauge.
    """
    if not isinstance(name, str) or name not in GAUGES:
        raise OptionError("gauge", name, "one of " + ", ".join(GAUGES))
    if name == "none":
        return Gauge(pattern, fixed, fixed, description="nothing is fixed")
    label = component_labels(pattern)
    touched, (anchored, oriented) = touched_variables(pattern), np.zeros((2, len(fixed)), dtype=bool)
    anchored[label[fixed]] = True
    for batch in pattern.batches:
        factor = batch.model.factor
        for mask, says in ((anchored, not factor.relative), (oriented, factor.knows_axes(batch.model.manifolds))):
            if says:
                mask[label[np.concatenate(batch.variables)]] = True
    if not (touched | fixed).all():
        isolated = np.flatnonzero(~touched & ~fixed)
        pronoun = "it" if len(isolated) == 1 else "them"
        warnings.warn(
            f"{_named(pattern, isolated)}: no measurement touches {pronoun}; fixed at the initial value. Add the "
            f"factors that are missing, or leave {pronoun} out of the values",
            GraphWarning,
            stacklevel=_outside(),
        )
        fixed = fixed | ~touched
    of_points = np.array([manifold in (R(2), R(3)) for manifold in pattern.manifolds.values()], dtype=bool)
    points = of_points.repeat([len(numbers) for numbers in pattern.numbers.values()])
    free = touched & ~calibrations(pattern) & ~anchored[label]
    chosen = _first_of_components(label, pattern, free & (points | ~oriented[label]))
    if not len(chosen):
        return Gauge(pattern, fixed, fixed, description="fixed by the graph itself")
    named = _named(pattern, chosen)
    if name == "prior":
        keys = [pattern.key(int(v)) for v in chosen]
        factors = [batch.model.factor for batch in pattern.batches]
        every = Pattern([*factors, *(Prior(key, values[key], Isotropic(1.0)) for key in keys)], values)
        return Gauge(every, fixed, fixed, f"a prior of unit information on {named}")
    held = fixed.copy()
    held[chosen] = True
    if name == "free":
        return Gauge(pattern, held, fixed, description=f"free, shortest step; computed with {named} fixed", free=True)
    return Gauge(pattern, held, fixed, description=f"{named} fixed")


def _outside() -> int:
    """The stack level, for the function that calls this, of the first frame that is not in these packages."""
    level, frame = 1, sys._getframe(1)
    while frame.f_globals.get("__name__", "").partition(".")[0] in OURS and frame.f_back is not None:
        level, frame = level + 1, frame.f_back
    return level


def _named(pattern: Pattern, variables: Index) -> str:
    """The first few of some variables, and how many more."""
    return some([pattern.key(int(v)) for v in variables])


def _first_of_components(label: Index, pattern: Pattern, some_of: Mask) -> Index:
    """Per component, of some variables (V,), that of most degrees of freedom, first kind, lowest number."""
    kinds = sorted(pattern.numbers, key=lambda kind: -pattern.manifolds[kind].dim)
    order = np.concatenate([*(by_number(pattern, kind) for kind in kinds), np.zeros(0, dtype=np.intp)])
    return firsts(label, order[some_of[order]])


def fixed_of(fixed: Sequence[Keys], stack: Stack) -> Mask:
    """Which variables (n,) of a kind are in a list of keys."""
    out = np.zeros(len(stack), dtype=bool)
    for keys in fixed:
        if keys.kind == stack.kind:
            out[stack.index(keys)] = True
    return out


def fixed_variables(fixed: Sequence[Keys], values: Values) -> Mask:
    """(V,) which variables are in a list of keys."""
    for keys in fixed:
        values.stack(keys.kind)  # refuses a kind there is none of
    return np.concatenate([np.zeros(0, dtype=bool), *(fixed_of(fixed, stack) for stack in values.stacks.values())])
