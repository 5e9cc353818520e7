"""Words about a robust choice: how many measurements it rejected, which landmarks left, and what nothing verifies."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

from models.listing import some

__all__ = ["left", "rejected_contacts", "rejections", "unverified"]

FEW = 3  # landmarks that are named


def unverified(factors: Sequence[str], redundancy: float, meters: float, sigmas: float) -> str:
    """A group of closures that nothing verifies, with its redundancy and how far the map moves without it."""
    motion = f"the map moves {meters:.3g} m ({sigmas:.2g} sigmas)" if isfinite(meters) else "the graph falls apart"
    return f"{some(factors, 1)}: redundancy {redundancy:.2f}, {motion} without it"


def rejections(count: int, doubted: int, by_chance: float, probability: float, sigma0: float) -> str:
    """How many measurements were rejected, and how many right ones are at a threshold of this probability."""
    scaled = "" if f"{sigma0:.3g}" == "1" else f" (sigmas times {sigma0:.3g})"
    right = "less than one is" if by_chance < 1 else f"about {by_chance:.0f} are"
    expected = f"{right} expected by chance at {100 * probability:.6g} %"
    return f"{count:,} of {doubted:,} doubted measurements rejected{scaled}; {expected}"


def rejected_contacts(count: int, doubted: int, by_chance: float, probability: float) -> str:
    """The same of contacts, in short."""
    return (
        f"{count:,} of {doubted:,} contacts rejected; {by_chance:.0f} expected by chance at {100 * probability:.6g} %"
    )


def left(landmarks: list[str], count: int) -> str:
    """Which landmarks left with what was rejected, and how many doubted measurements of theirs."""
    return f"{some(landmarks, FEW)} left with them: too few of {count} doubted measurements of theirs agree"
