"""The chi-squared distribution, as the pages import it; the functions stand in `models.chi_squared`."""

from models.chi_squared import (
    chi2_gate,
    chi2_interval,
    chi2_log_tail,
    chi2_tail,
    innovation_distances,
    mahalanobis,
)

__all__ = ["chi2_gate", "chi2_interval", "chi2_log_tail", "chi2_tail", "innovation_distances", "mahalanobis"]
