"""The result of a check of the setup of a scan mission: numbers; `words` makes sentences of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

__all__ = ["BENDING", "SetupFinding", "SetupKind"]


class SetupKind(StrEnum):
    """A wrong setup, the identifier that programs get."""

    UNREPEATED = "unrepeated"
    MIRRORED = "mirrored"
    MOUNTING = "mounting"
    TURNED = "turned"
    TIME_OFFSET = "time_offset"
    SIGMAS_TOO_LARGE = "sigmas_too_large"
    SIGMAS_TOO_SMALL = "sigmas_too_small"


BENDING = frozenset({SetupKind.UNREPEATED, SetupKind.MIRRORED, SetupKind.TIME_OFFSET})  # what follows is no map


@dataclass(frozen=True)
class SetupFinding:
    """A wrong setup.

    Attributes
    ----------
    kind : of it.
    numbers : by name, m, rad and s.

        - ``unrepeated``: `scans` that were matched with those just before them, and how many of these `fit`.
        - ``mirrored``: steps that turn and fit better as `given`, and `mirrored`.
        - ``mounting``: `component` x, y or yaw, its `value` and `sigma` from the assumed one, and the `mount` (3,) that
          follows.
        - ``turned``: `value` and `sigma` of the yaw that is missing if nothing drifts sideways, and `mount`.
        - ``time_offset``: `value`, by which the stamps of the scans are late, and `sigma`.
        - ``sigmas_too_large``, ``sigmas_too_small``: `measurements` steps, drifts or closures, `chi2`, `dof`, `scale`
          on the stated sigmas.
    """

    kind: SetupKind
    numbers: Mapping[str, Any]
