"""Which accepted groups are listed as not verified: large wrong groups on manhattan, and choices that are right.

    LEADLINE_DATA=DIR python benchmarks/evidence/unverified_groups.py [--seeds N]

A failure is a map that is off by 1 % of the extent or more. A wrong group is accepted whole where most of it is.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from script import at_least_one, public_data
from wrong_closures import KINDS, SETS, solved, spoiled

import nls

FINE = 0.01  # of the extent
ENDS = ("random", "local", "alias")
SMALL = ("CSAIL", "INTEL", "intel", "FR079", "ring", "kitti_00")
SEEDS = 9


def tasks(seeds: int) -> Iterator[tuple[str, str, int, float, int]]:
    """Graph, ends, size of a group, share of wrong closures, seed."""
    for name in SMALL:
        yield from ((name, ends, 1, share, 0) for ends in ENDS for share in (0.1, 0.3))
        yield from ((name, "random", 10, 0.3, 1), (name, "alias", 10, 0.1, 1))
    yield from (("manhattan", ends, 1, 0.3, 0) for ends in ENDS)
    for size in (30, 100):
        yield from (("manhattan", ends, size, share, 0) for ends in ("random", "alias") for share in (0.1, 0.3, 0.5))
        yield from (("manhattan", "alias", size, share, seed) for share in (0.4, 0.5) for seed in range(1, seeds))


def row(data: Path, name: str, ends: str, size: int, share: float, seed: int) -> str:
    """A trial as a row of the table: the choice, and the groups that are listed."""
    right = solved(data / SETS[name])
    kind = f"{ends}, {size} in a group"
    KINDS[kind] = ends, size
    wrong = round(share / (1 - share) * int(right.loops.sum()))
    rng = np.random.default_rng([seed, ENDS.index(ends), size, round(100 * share)])
    choice = nls.gnc(nls.FactorGraph([right.edges, spoiled(right, wrong, kind, rng)]), right.start)
    off = right.off(choice.result.values)
    lists = [
        f"{sum(factor > 0 for factor, _ in group.closures)} of {len(group.closures)} wrong, redundancy "
        f"{group.redundancy:.0e}, {group.meters:.3g} m, {group.sigmas:.2g} sigmas"
        for group in choice.unverified
    ]
    doubts = ", ".join(doubt.kind.name for doubt in choice.doubts)
    accepted = int(choice.weights[1].sum())
    numbers = f"{100 * off:.2f} % | {'' if off < FINE else 'failure'} | {accepted} of {wrong} | {doubts}"
    return f"| {name} | {kind} | {share:.0%} | {seed} | {numbers} | {'; '.join(lists)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=at_least_one, default=SEEDS, help="of aliases on manhattan")
    options = parser.parse_args()
    data = public_data(parser)
    print("| graph | wrong ones | share | seed | off | | accepted | doubts | accepted, not verified |")
    print("|:--|:--|--:|--:|--:|:--|--:|:--|:--|")
    for task in tasks(options.seeds):
        print(row(data, *task), flush=True)


if __name__ == "__main__":
    main()
