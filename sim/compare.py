r"""One data set, every estimator: errors, covariances, time and memory side by side.

NEES is that of the last pose, e' P^-1 e. Of a consistent estimator its mean over independent runs is within bounds
with 95 %; the poses of one run are not independent. A covariance that is singular gives errors no size. Few particles,
of which one has nearly all the weight, do not know their error. Time is that of the processor for the whole run over
its steps, on one BLAS thread. Memory is the largest that Python and NumPy held at once; a solver in C is not counted.
"""

from __future__ import annotations

import tracemalloc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from time import process_time

import numpy as np

from nls.filters.base import Track
from nls.filters.consistency import nees_bounds
from sim.estimators import errors, tracked
from sim.landmark_world import LandmarkWorld
from sim.monte_carlo import Record

__all__ = ["compare", "compared_rows", "monte_carlo_rows"]

COLUMNS = ("ate", "aligned", "smoothed", "final", "landmarks")
SINGULAR = "singular"
TITLES = ("ATE", "aligned", "smoothed", "final", "landmarks", "3 sigma")


@dataclass(frozen=True)
class Compared:
    """One estimator on one data set.

    Attributes
    ----------
    name : of the estimator.
    track : its estimates.
    errors : `sim.estimators.errors`.
    seconds : of the processor, for the run.
    megabytes : held at once at most; None where it was not measured.
    """

    name: str
    track: Track
    errors: dict[str, float]
    seconds: float
    megabytes: float | None


def compare(
    world: LandmarkWorld, estimators: Sequence[str], settings: Mapping[str, int], memory: bool = False
) -> list[Compared]:
    """Run estimators on one world, one after the other.

    Parameters
    ----------
    world : the data set.
    estimators : some of `sim.estimators.ESTIMATORS`.
    settings : of the estimators, see `sim.estimators.tracked`.
    memory : measure memory in a second run, about three times as slow.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> world = sim.subsea(np.random.default_rng(1), laps=1, known_start=True)
    >>> found = compare(world, ["batch", "ekf"], {})
    >>> [each.errors["ate"] < 0.4 for each in found]
    [True, True]
    """
    out = []
    for name in estimators:
        began = process_time()
        track = tracked(world, name, **settings)
        seconds = process_time() - began
        held = _held(world, name, settings) if memory else None
        out.append(Compared(name, track, errors(world, track), seconds, held))
    return out


def compared_rows(world: LandmarkWorld, entries: Sequence[Compared]) -> list[tuple[str, str]]:
    """The table, one (label, text) a line."""
    low, high = nees_bounds(entries[0].track.manifold.dim, 1)
    memory = entries[0].megabytes is not None
    head = [*TITLES, "NEES", "ms/step", *(["MB"] if memory else [])]
    rows = [
        ("estimator", "".join(f"{title:>10s}" for title in head)),
        ("dead reckoning", f"{world.ate(world.start):10.3f}"),
    ]
    for entry in entries:
        e = entry.errors
        numbers = [*(f"{e[c]:.3f}" for c in COLUMNS), f"{3 * e['sigma']:.3f}"]
        numbers += [f"{e['nees']:.4g}" if "nees" in e else SINGULAR]
        numbers += [f"{1e3 * entry.seconds / len(entry.track.x):.2f}"]
        numbers += [f"{entry.megabytes:.2f}"] if entry.megabytes is not None else []
        rows.append((entry.name, "".join(f"{text:>10s}" for text in numbers)))
    return [*rows, ("NEES", f"of the last pose; {low:.2f} to {high:.2f} with 95 %"), *quality(rows)]


def monte_carlo_rows(seeds: Sequence[int], records: Sequence[Record], dim: int) -> list[tuple[str, str]]:
    """The table of many runs of `sim.estimators.of_seed`: means, and the NEES of poses of `dim` with its bounds."""
    low, high = nees_bounds(dim, len(records))
    count = f"{len(records)}" if len(records) == len(seeds) else f"{len(records)} of {len(seeds)}"
    rows = [("runs", f"{count}, seeds {seeds[0]} to {seeds[-1]}; means over them, ATE also smallest and largest")]
    rows.append(("estimator", "".join(f"{title:>10s}" for title in (*TITLES, "NEES", "ATE from", "to"))))
    for name in records[0]:
        records_of_name = [record[name] for record in records]
        columns = {key: np.array([e[key] for e in records_of_name]) for key in records_of_name[0] if key != "nees"}
        numbers = [f"{columns[c].mean():.3f}" if c in columns else "" for c in COLUMNS]
        if "sigma" in columns:
            regular = all("nees" in e for e in records_of_name)
            numbers += [f"{3 * columns['sigma'].mean():.3f}"]
            numbers += [f"{np.mean([e['nees'] for e in records_of_name]):.4g}" if regular else SINGULAR]
        else:
            numbers += ["", ""]
        numbers += [f"{columns['ate'].min():.3f}", f"{columns['ate'].max():.3f}"]
        rows.append((name, "".join(f"{text:>10s}" for text in numbers)))
    return [*rows, ("NEES", f"of the last pose, mean; {low:.2f} to {high:.2f} with 95 %"), *quality(rows)]


def quality(rows: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    """The columns of these rows."""
    lines = [
        ("ATE", "m, rmse of the positions when each was the latest; aligned: after the best rigid motion"),
        ("smoothed", "m, rmse of the positions in the final estimate, nothing aligned"),
        ("landmarks", "m, rmse of the landmarks in the end, nothing aligned; of walls that of their distance r"),
        ("final, 3 sigma", "m, error of the last position, and its stated 3 sigma per axis"),
    ]
    if any(SINGULAR in text for _, text in rows):
        lines.append((SINGULAR, "no NEES: the covariance of the last pose is singular in at least one run"))
    return lines


def _held(world: LandmarkWorld, name: str, settings: Mapping[str, int]) -> float:
    """The largest that was held at once, MB."""
    tracemalloc.start()
    try:
        tracked(world, name, **settings)
        return tracemalloc.get_traced_memory()[1] / 1e6
    finally:
        tracemalloc.stop()
