"""A match of two scans from nearby poses of the track: no loop closure."""

from __future__ import annotations

from factors.between import Between

__all__ = ["SequentialMatch"]


class SequentialMatch(Between):
    r"""A pose relative to one shortly before it, by scans from both: a part of the track, no loop closure.

    .. math:: h(x_i, x_j) = x_i^{-1} x_j, \quad H_i = -\mathrm{Ad}_{h^{-1}}, \quad H_j = I

    Parameters
    ----------
    i, j : the poses, earlier and later.
    z : (n, size) measured differences, as of `Between`.
    noise : as of `Between`.
    convention : as of `Between`.

    Notes
    -----
    The prediction is that of `Between`. Numbers of poses do not tell one from the other. A small loop may close after
    three poses, and a scan may be matched with the third before it. So the factor says it, and is not tested as a
    closure.

    Examples
    --------
    >>> from factors import Between, Isotropic, SequentialMatch
    >>> from models import SE2
    >>> from nls import FactorGraph, Values, kinds
    >>> from nls.posegraph import closures
    >>> (x,) = kinds("x")
    >>> graph = FactorGraph([kind(x[0], x[3], [3.0, 0.0, 0.0], Isotropic(0.1)) for kind in (Between, SequentialMatch)])
    >>> [mask.tolist() for mask in closures(graph.pattern(Values({x: (SE2, SE2.identity(4))})))]
    [[True], [False]]
    """

    sequential = True
