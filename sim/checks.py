"""Refusals of sizes and noise that no world can have, before any memory is taken."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from models.errors import OptionError
from models.options import MAX_SIZE, is_number, is_whole

MAX_POSES = 10_000_000  # 560 MB of truth in three dimensions; more is a slip of the keyboard


def check_rng(rng: Any) -> None:
    """A generator, not a seed: who calls decides what is random.

    Raises
    ------
    OptionError
    """
    if not isinstance(rng, np.random.Generator):
        raise OptionError("rng", rng, "a generator such as numpy.random.default_rng(0)")


def check_size(option: str, value: int, least: int) -> None:
    """A whole number from `least` to `MAX_POSES`.

    Raises
    ------
    OptionError
    """
    if not is_whole(value) or not least <= value <= MAX_POSES:
        raise OptionError(option, value, f"a whole number from {least} to {MAX_POSES}")


def check_poses(option: str, poses: int) -> None:
    """A product of sizes that is not too large.

    Raises
    ------
    OptionError
    """
    if poses > MAX_POSES:
        raise OptionError(option, poses, f"at most {MAX_POSES} poses")


def check_not_negative(**options: float) -> None:
    """Numbers of at least 0 whose squares are finite, by option.

    Raises
    ------
    OptionError
    """
    for option, value in options.items():
        if not (is_number(value) and 0 <= value < math.inf):
            raise OptionError(option, value, "a number of at least 0")
        if value > MAX_SIZE:
            raise OptionError(option, value, f"at most {MAX_SIZE:g}")


def check_fraction(**options: float) -> None:
    """Numbers from 0 to 1, by option.

    Raises
    ------
    OptionError
    """
    for option, value in options.items():
        if not (is_number(value) and 0 <= value <= 1):
            raise OptionError(option, value, "a number from 0 to 1")
