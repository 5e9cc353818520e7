"""Contents of a graph, free directions, doubted measurements and cures, in plain words."""

from nls.explanation.explain import explain
from nls.explanation.findings import Explanation, Finding, FindingKind, Measurement, Part, Weak

__all__ = ["Explanation", "Finding", "FindingKind", "Measurement", "Part", "Weak", "explain"]
