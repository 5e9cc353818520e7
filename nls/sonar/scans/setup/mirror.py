"""Azimuths of the wrong sign: do scans of consecutive keyframes fit the turn between them better when mirrored?

A mirrored scan turns against the vehicle. Every step that turns is a witness, also where no loop closes. Closures of a
first round tell the same on a way that comes back from other headings, 146 accepted against 6 in a harbor. On laps they
do not: mirrored scans of one heading agree with each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.keys import kinds
from nls.sonar.scans.scans import Scans
from nls.sonar.scans.setup.neighbors import match_steps, steps
from nls.values import Values

__all__ = ["Mirror", "mirror"]

STEPS = 100  # those that turn most
TURN = float(np.radians(3.0))  # least turn of a step
WINDOW = (1.0, float(np.radians(3.0)))  # m, rad: narrower than the turn, so that its sense counts
TIMES = 3.0  # as many steps for the mirror as against it: 30 of 40 by chance is one case in 1,000
LEAST = 10  # steps for the mirror; right setups of the harbor have 94 to 99 of 100 against it
x = kinds("x")[0]


@dataclass(frozen=True)
class Mirror:
    """Steps that turn, by how the scans fit them better.

    Attributes
    ----------
    given, mirrored : steps that fit better as given, and mirrored.
    """

    given: int
    mirrored: int

    @property
    def wrong(self) -> bool:
        """Whether azimuths have the wrong sign."""
        return self.mirrored >= LEAST and self.mirrored > TIMES * self.given


def mirror(values: Values, scans: Scans) -> Mirror:
    """Which steps fit better as given, and which mirrored, from keyframes x (SE2) by dead reckoning."""
    poses = values[x]
    i, turn = steps(poses, scans)
    i = i[np.argsort(-turn, kind="stable")[: min(STEPS, int((turn >= TURN).sum()))]]
    better = match_steps(poses, scans.mirrored(), i, WINDOW).score - match_steps(poses, scans, i, WINDOW).score
    return Mirror(int((better < 0).sum()), int((better > 0).sum()))
