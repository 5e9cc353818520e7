"""Landmarks first: the Schur complement of variables that share no factor with each other."""

from nls.linear.schur.inverses import truncated_inverse
from nls.linear.schur.pcg import PCG
from nls.linear.schur.solver import Schur

__all__ = ["PCG", "Schur", "truncated_inverse"]
