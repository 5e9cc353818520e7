"""What a graph is made of, what it leaves free, which measurements it doubts, and what would help: in plain words."""

from nls.explanation.explain import explain
from nls.explanation.findings import Explanation, Finding, FindingKind, Measurement, Part, Weak

__all__ = ["Explanation", "Finding", "FindingKind", "Measurement", "Part", "Weak", "explain"]
