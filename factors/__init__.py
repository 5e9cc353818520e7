"""Factors: one measurement kind per file; noise, measurement and spaces bound into whitened Jacobians and errors."""

from factors.base import Factor
from factors.between import Between
from factors.check import check_jacobians
from factors.noise import Covariance, Diagonal, Information, Isotropic, Noise, SqrtInformation
from factors.prior import Prior

__all__ = [
    "Between",
    "Covariance",
    "Diagonal",
    "Factor",
    "Information",
    "Isotropic",
    "Noise",
    "Prior",
    "SqrtInformation",
    "check_jacobians",
]
