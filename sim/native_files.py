"""The graph of any world as native files: with its start, and with its truth."""

from __future__ import annotations

from typing import Protocol

from nls.graph import FactorGraph
from nls.values import Values

__all__ = ["HOLD", "native_files"]

HOLD = "graph.npz: the measurements and the start, as nls solve reads them.\ntruth.npz: the same, and what is true.\n"


class Simulated(Protocol):
    """Attributes of every world."""

    @property
    def graph(self) -> FactorGraph: ...
    @property
    def start(self) -> Values: ...
    @property
    def truth(self) -> Values: ...


def native_files(world: Simulated) -> dict[str, bytes]:
    """graph.npz and truth.npz by name.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> list(native_files(sim.rig(np.random.default_rng(0), poses=3, points=5)))
    ['graph.npz', 'truth.npz']
    """
    from nls.io import rendered  # only here: a table needs no file formats

    values = {"graph.npz": world.start, "truth.npz": world.truth}
    return {name: rendered(name, world.graph, estimate)[0] for name, estimate in values.items()}
