"""Freed arrays stay in the process, so that those of the next iteration lie in memory it has.

The C library of Linux asks the system for an array of more than 128 KB, and gives it back when it is freed. The system
clears every page it gives, 2 us for 4 KB: a seventh of the time from file to optimum of parking-garage.

The library no longer does so for arrays up to the size of the largest that was freed, 32 MB at most, and it keeps twice
that size (mallopt(3), "dynamic mmap threshold"). So one such array is asked for and freed here, in 20 us. It takes no
memory, as nothing is written to it.
"""

from __future__ import annotations

import numpy as np

__all__ = ["keep_freed_memory"]

LARGEST = (1 << 25) - (1 << 16)  # bytes; the chunk around it must not be above 32 MB


def keep_freed_memory() -> None:
    """Let the C library keep up to 64 MB that are freed. Elsewhere than with glibc nothing changes."""
    np.empty(LARGEST, dtype=np.uint8)
