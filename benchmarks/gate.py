"""A gate for speed: processor times over those of a reference computation beside them, against committed baselines.

Both are timed in turn, many times, with one BLAS thread; the smallest processor times are compared. Such ratios stay
the same where times do not: on a busy machine, and much the same on another one. A ratio that exceeds its baseline by
half is measured again; when it does so again it is named, and the exit status is 1. --update writes the ratios of this
run as the new baselines.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from time import process_time

from harness import machine, positive

ALLOWED = 1.5  # times its baseline
LEAST = 5  # rounds of a ratio

Clock = Callable[[], float]  # seconds of one run


def stopwatch(work: Callable[[], object]) -> Clock:
    """Processor time of one run."""

    def timed() -> float:
        began = process_time()
        work()
        return process_time() - began

    return timed


def add_options(parser: argparse.ArgumentParser, baselines: Path) -> None:
    parser.add_argument("--update", action="store_true", help="write the ratios of this run as the new baselines")
    parser.add_argument("--baselines", type=Path, default=baselines, metavar="FILE", help="default beside this script")
    parser.add_argument("--seconds", type=positive, default=2.0, help="processor time for one ratio")


def refuse(parser: argparse.ArgumentParser, options: argparse.Namespace, only: bool) -> None:
    """Refuse what cannot be compared, before anything is measured."""
    if options.update and only:
        parser.error("--update needs all ratios: leave out --only and --sets")
    if not options.update and not options.baselines.exists():
        parser.error(f"{options.baselines} does not exist: make it with --update")


def ratio(ours: Clock, reference: Clock, seconds: float) -> tuple[float, float, int]:
    """Least time of ours over least time of the reference, run in turn; the least time of ours; rounds."""
    a, b = [ours()], [reference()]  # the first runs load what is loaded late
    rounds, spent = 0, 0.0
    while rounds < LEAST or spent < seconds:
        a.append(ours())
        b.append(reference())
        spent += a[-1] + b[-1]
        rounds += 1
    return min(a) / min(b), min(a), rounds


def gate(name: str, pairs: dict[str, tuple[Clock, Clock]], options: argparse.Namespace) -> int:
    """Measure all ratios, ours and the reference, and compare them, or write them; the exit status."""
    head = machine()
    baselines: dict[str, float] = {} if options.update else json.loads(options.baselines.read_text())["ratios"]
    ratios, over = {}, []
    print(f"{'ours / reference':20s}{'ratio':>8s}{'baseline':>10s}{'ours, ms':>10s}{'rounds':>8s}")
    for title, pair in pairs.items():
        ratios[title], least, rounds = ratio(*pair, options.seconds)
        baseline = baselines.get(title)
        if baseline is not None and ratios[title] > ALLOWED * baseline:
            again, least, rounds = ratio(*pair, 2 * options.seconds)
            ratios[title] = min(ratios[title], again)
            if ratios[title] > ALLOWED * baseline:
                over.append(f"{title}: {ratios[title]:.3g}, {ratios[title] / baseline:.1f} times its {baseline:.3g}")
        shown = f"{baseline:.3g}" if baseline is not None else "none"
        print(f"{title:20s}{ratios[title]:8.3g}{shown:>10s}{1e3 * least:10.2f}{rounds:8d}", flush=True)
    if options.update:
        record = {"machine": [line.removeprefix("- ") for line in head], "ratios": ratios}
        options.baselines.write_text(json.dumps(record, indent=1) + "\n")
        print(f"written: {options.baselines}")
        return 0
    if unnamed := [title for title in ratios if title not in baselines]:
        over.append(f"no baseline for {', '.join(unnamed)}: make them with --update")
    for line in over:
        print(f"{name}: {line}", file=sys.stderr)
    return 1 if over else 0
