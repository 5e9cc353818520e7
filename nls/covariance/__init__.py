"""Covariances of the estimate: of single variables, of sets of them, and of all at once."""

from nls.covariance.frames import Joint
from nls.covariance.gate import Gate
from nls.covariance.marginals import Marginals

__all__ = ["Gate", "Joint", "Marginals"]
