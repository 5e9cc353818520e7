"""What a data set determines of a mounting, a lens, a bias, and which motion would help.

`observability` gives the standard deviation of every component of one variable with everything else estimated too, its
free and its weak directions by name; `helpful_motions` asks the same with one more view, for one motion after another.
"""

from nls.observability.information import observability
from nls.observability.motions import Motion, Motions, helpful_motions
from nls.observability.report import Observability

__all__ = ["Motion", "Motions", "Observability", "helpful_motions", "observability"]
