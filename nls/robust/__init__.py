"""Wrong measurements: which loop closures to accept, and the estimate without the others."""

from nls.robust.accepted_closures import Growth, grow
from nls.robust.graduated import Rejected, Robustified, gnc
from nls.robust.verdict import Doubt, DoubtKind

__all__ = ["Doubt", "DoubtKind", "Growth", "Rejected", "Robustified", "gnc", "grow"]
