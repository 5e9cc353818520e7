"""Wrong measurements: which loop closures to believe, and the estimate without the others."""

from nls.robust.graduated import Rejected, Robustified, gnc
from nls.robust.growth import Growth, grow

__all__ = ["Growth", "Rejected", "Robustified", "gnc", "grow"]
