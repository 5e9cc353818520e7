"""Landmarks first: the Schur complement of variables that share no factor with each other."""

from __future__ import annotations

from nls.linear.schur.pcg import PCG
from nls.linear.schur.solver import Schur
from nls.linear.schur.truncated import truncated_inverse

__all__ = ["PCG", "Schur", "truncated_inverse"]
