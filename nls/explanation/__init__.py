"""Contents of a graph, free directions, suspected measurements and cures, in plain words."""

from typing import TYPE_CHECKING

from nls.explanation.findings import Explanation, Finding, FindingKind, Measurement, Part, Weak
from nls.lazy import importer

if TYPE_CHECKING:
    from nls.explanation.explanation import explain

__all__ = ["Explanation", "Finding", "FindingKind", "Measurement", "Part", "Weak", "explain"]

# `explain` needs every analysis, and findings of other rooms need none
__getattr__, __dir__, _ = importer(__name__, {"nls.explanation.explanation": "explain"})
