r"""The covariance of integrated legs: every error of a sample followed, to first order, to the end of its legs.

A leg is the product of steps Exp(xi_k), xi_k = (v dt, turn) in the frame of the DVL. An error dxi_k of one step moves
the end of the leg, z, by the right increment

    delta = Ad_z^-1 L_k dxi_k,    L_k = Ad_{T_k} J_l(xi_k)      T_k: from the start of the leg to the start of the step

and steps depend on the values at the nodes of the time grid on either side of them, these on samples:

    dxi_k = A_k n_k + B_k n_k+1,    n = (1 - s) e_a + s e_b

So delta is a sum over independent sample errors e, each with a 6 x 3 coefficient G. Its covariance is the sum of
G sigma^2 G'. A velocity or rate may be part of two legs (between them, or of all legs in the drop-out it bounds), with
the time weights w_i. Factors cannot say so, and e counts in leg i with 1/p_i of its variance, p_i = w_i / sum_j w_j:

    Sigma_i = G_i sigma^2 G_i' / p_i,    (sum_i a_i)^2 <= sum_i a_i^2 / p_i    (Cauchy-Schwarz)

no combination of legs is better known than the shared sample allows, and the sum of legs in one direction is exact.
Source: T. Barfoot, State Estimation for Robotics, 2017, section 7.3.3 (compounding of uncertain poses).
"""

from __future__ import annotations

import numpy as np

from models.algebra import Array, Index
from models.dead_reckoning.samples import Mixture


def at_nodes(LA: Array, LB: Array, leg: Index) -> Array:
    """Coefficients of the nodes of every leg, from those of the steps.

    Parameters
    ----------
    LA, LB : (m, ...) of the m steps, for the nodes before and after: L_k A_k and L_k B_k (6, 3).
    leg : (m,) the leg of each step, 0 to k - 1, rising.

    Returns
    -------
    C : (m + k, ...) for the nodes of the k legs one after the other: a node on a boundary is in two legs, and there
        twice. The nodes of step i are at i + leg[i] and the next place.
    """
    left = np.arange(len(leg)) + leg
    C = np.zeros((len(leg) + leg[-1] + 1, *LA.shape[1:]))
    C[left] = LA
    C[left + 1] += LB
    return C


def from_samples(C: Array, leg: Index, mix: Mixture, sigma: Array, k: int, weight: Array | None = None) -> Array:
    """Sum of G sigma^2 G' over the samples, leg by leg.

    Parameters
    ----------
    C : (m, 6, 3) coefficients of nodes.
    leg : (m,) their legs, rising.
    mix : the samples each node is mixed from.
    sigma : (n, 3) standard deviations of the samples.
    k : how many legs there are.
    weight : (m,) of the nodes, above 0: samples that are part of several legs count by it; as if each leg had its own
        when omitted.

    Returns
    -------
    Sigma : (k, 6, 6) array.
    """
    n, two = len(sigma), np.flatnonzero(mix.s > 0)
    source = np.concatenate([leg * n + mix.a, leg[two] * n + mix.b[two]])  # one number for a leg and a sample

    def parts(y: Array) -> Array:
        """Values of the nodes (m, ...), from both samples."""
        s = mix.s.reshape(-1, *[1] * (y.ndim - 1))
        return np.concatenate([(1 - s) * y, s[two] * y[two]])

    order = np.argsort(source, kind="stable")
    source, first = np.unique(source[order], return_index=True)
    sample = source % n
    G = np.add.reduceat(parts(C)[order], first) * sigma[sample, None, :]
    if weight is not None:
        w = np.add.reduceat(parts(weight)[order], first)
        p = w / np.bincount(sample, w, n)[sample]
        G /= np.sqrt(p)[:, None, None]
    return sum_by_leg(G @ G.mT, source // n, k)


def sum_by_leg(terms: Array, leg: Index, k: int) -> Array:
    """Sums (k, ...) of terms (m, ...) over their legs (m,), rising; 0 for a leg without terms."""
    out = np.zeros((k, *terms.shape[1:]))
    legs, first = np.unique(leg, return_index=True)
    out[legs] = np.add.reduceat(terms, first)
    return out
