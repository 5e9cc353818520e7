"""Units of components by their names."""

from __future__ import annotations

__all__ = ["ANGLES", "LENGTHS", "unit"]

ANGLES = frozenset({"azimuth", "bearing", "elevation", "pitch", "roll", "yaw"})  # what is wrapped; the rest is not
LENGTHS = frozenset({"x", "y", "z", "range"})


def unit(component: str) -> str:
    """The unit of a component by its name: rad, m, or empty where it is neither an angle nor a length."""
    return "rad" if component in ANGLES else "m" if component in LENGTHS else ""
