"""Command line of the scenes for filters: one estimator, many seeds, or all estimators side by side."""

from __future__ import annotations

import argparse
import warnings
from dataclasses import asdict
from functools import partial
from typing import Any

import numpy as np

from models.errors import OptionError
from models.listing import some
from sim.arguments import add_outputs, add_parameters, flag, number, parameters, whole_number
from sim.compare import compare, compared_rows, monte_carlo_rows
from sim.estimators import ESTIMATORS, SCENES, errors, estimator, followed, of_seed, tracked
from sim.files import HOLD, Contents, Files, Rows, native_files
from sim.landmark_world import LandmarkWorld
from sim.monte_carlo import FailedRunsError, runs, sentence
from sim.scaling import FITTED, SCALED, costs, panels, scaling_rows

SCENE_FILES = "graph.npz, truth.npz, estimate.png and offsets.png (four pictures each), estimate.json"
SETTINGS = {  # of the estimators: which has it, and what it is
    "particles": (("fastslam1", "fastslam2"), "particles of fastslam1 and fastslam2 (default 100)"),
    "lag": (("fixed-lag",), "poses in the window of fixed-lag (default 20)"),
    "iterations": (("ekf",), "largest number of linearizations of one ekf update (default 1)"),
}
LIMIT = 20.0  # s
LISTED = 20  # failed seeds in the table
EXAMPLE = """examples:
  nls-sim compare --world lines --laps 1 --estimators ekf batch --out compared
  nls-sim compare --scaling --out cost
"""
Estimated = tuple[Rows, Files, str, FailedRunsError | None]


def add_estimators(sub: argparse.ArgumentParser) -> None:
    """Options of a scene that choose the estimator, and how often it runs."""
    sub.add_argument("--estimator", choices=ESTIMATORS, default="ekf", help="the estimator (default ekf)")
    _add_settings(sub)


def add_compare(worlds: Any) -> None:
    """The command ``compare``."""
    sub = worlds.add_parser(
        "compare",
        help="Estimators side by side on one scene: one table and one picture.",
        description="Run estimators on the same measurements of one scene, or of many seeds, and compare errors, "
        "covariances, time and memory.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    add_outputs(sub, "compare.png and .json (scaling.png and .json)")
    unset = argparse.SUPPRESS
    sub.add_argument("--world", choices=list(SCENES), default=unset, help="the scene (default subsea)")
    sub.add_argument(
        "--estimators",
        nargs="+",
        choices=ESTIMATORS,
        default=unset,
        metavar="NAME",
        help=f"estimators to run: {', '.join(ESTIMATORS)} (default all; with --scaling {', '.join(SCALED)})",
    )
    sub.add_argument(
        "--scaling",
        nargs="?",
        type=number,
        const=LIMIT,
        metavar="SECONDS",
        help="what a step costs against the number of landmarks, on rings of 100 to 12,800; an estimator stops before "
        f"a ring that would take longer than this (default {LIMIT:g})",
    )
    sub.add_argument("--memory", action="store_true", help="measure memory in a second run, three times slower")
    add_parameters(sub, SCENES["subsea"], unset=True)  # those of the other scenes are among them
    _add_settings(sub)


def estimated(name: str, seed: int, arguments: dict[str, Any], pictured: bool) -> Estimated:
    """The table of a scene or of ``compare``, what writes its files, what the scene is, and which runs failed.

    Parameters
    ----------
    name : of a scene, or ``compare``.
    seed : the first one.
    arguments : the options of the command line.
    pictured : whether the files are going to be written: pictures of landmarks need their covariances at each step.

    Raises
    ------
    OptionError
        Options that do not go together, or with values they cannot have.
    """
    options = dict(arguments)
    if (limit := options.pop("scaling", None)) is not None:
        return *_scaled(seed, limit, options), None
    memory, count, file = options.pop("memory", False), options.pop("runs"), options.pop("resume")
    settings = {setting: options.pop(setting) for setting in SETTINGS if setting in options}
    scene = options.pop("world", "subsea" if name == "compare" else name)
    names = options.pop("estimators", list(ESTIMATORS)) if name == "compare" else [options.pop("estimator")]
    _refuse(scene, names, options, settings)
    if file is not None and (count is None or not file):
        raise OptionError("resume", file, "the name of a file, together with --runs")
    if memory and count is not None:
        raise OptionError("--memory and --runs do not go together; leave one out")
    world = SCENES[scene](np.random.default_rng(seed), **options)
    for method in names:
        estimator(world, method, **settings)  # refused here, not in the processes that run it
    request = {"world": scene, "seed": seed, "options": options, "settings": settings}
    head = scene_rows(world)
    if count is not None:
        return _many(world, head, request, names, count, file)
    if name == "compare":
        return *_compared(world, head, request, names, memory), None
    return *_single(world, head, request, names[0], pictured), None


def scene_rows(world: LandmarkWorld) -> Rows:
    """The table of a scene."""
    return [
        ("world", f"{world.name}, seed {world.seed}"),
        ("poses", f"{world.poses} in {world.truth.stack('x').manifold}"),
        ("landmarks", f"{world.landmarks} in {world.truth.stack('l').manifold}, {len(world.sightings)} sightings"),
        ("chi2 at truth", f"{world.graph.chi2(world.truth):.6g}, expected {world.rows} (numbers drawn)"),
        ("dead reckoning", f"{world.ate(world.start):.4g} m (ATE, rmse of positions, nothing aligned)"),
    ]


def _single(
    world: LandmarkWorld, head: Rows, request: dict[str, Any], name: str, pictured: bool
) -> tuple[Rows, Files, str]:
    from nls.filters.consistency import nees_bounds

    settings = request["settings"]
    track, history = followed(world, name, **settings) if pictured else (tracked(world, name, **settings), [])
    statistics = errors(world, track)
    low, high = nees_bounds(track.manifold.dim, 1)
    singular = "not defined: the covariance is singular"
    nees = f"{statistics['nees']:.4g} of the last pose" if "nees" in statistics else singular
    walls = f" in r, {statistics['walls']:.3g} deg in alpha" if "walls" in statistics else ""
    rows = [
        ("estimator", track.method),
        ("ATE", f"{statistics['ate']:.4g} m, {statistics['aligned']:.4g} m after the best rigid motion"),
        ("smoothed", f"{statistics['smoothed']:.4g} m (ATE of the final estimate of all poses)"),
        ("map", f"{statistics['landmarks']:.4g} m{walls} (rmse of {len(track.landmarks)} landmarks in the end)"),
        ("final", f"{statistics['final']:.4g} m off; 3 sigma {3 * statistics['sigma']:.4g} m per axis"),
        ("NEES", f"{nees}; {low:.2f} to {high:.2f} with 95 %"),
    ]

    def files() -> Contents:
        from nls.plot import offsets
        from nls.plot.filters import estimator_figure
        from nls.plot.picture import drawn

        title, sightings = f"{world.name}, seed {world.seed}", world.sightings.keys
        figure = estimator_figure(track, world.truth, history, title, sightings)
        beside = drawn("offsets.png", offsets(track, world.truth, title, sightings))
        report = {**request, "estimator": name, "method": track.method, **statistics}
        return {**_pictured("estimate", figure, report), "offsets.png": beside, **native_files(world)}, (
            "estimate.png: the map, sigmas of vehicle and landmarks, errors within 3 sigma.\n"
            "offsets.png: the map, and errors of heading, position and landmarks along the axes of the world.\n"
            "estimate.json: options and errors, m.\n" + HOLD
        )

    return [*head, *rows], files, world.description


def _compared(
    world: LandmarkWorld, head: Rows, request: dict[str, Any], names: list[str], memory: bool
) -> tuple[Rows, Files, str]:
    comparison = compare(world, names, request["settings"], memory)

    def files() -> Contents:
        from nls.plot.filters import several

        tracks, title = [entry.track for entry in comparison], f"{world.name}, seed {world.seed}"
        figure = several(tracks, world.truth, world.start, title)
        report = {
            e.name: {"method": e.track.method, **e.errors, "seconds": e.seconds, "megabytes": e.megabytes}
            for e in comparison
        }
        contents = _pictured("compare", figure, {**request, "estimators": report})
        return contents, "compare.png: tracks, errors, 3 sigma, NEES.\ncompare.json: the table, m and s.\n"

    return [*head, *compared_rows(world, comparison)], files, world.description


def _scaled(seed: int, limit: float, arguments: dict[str, Any]) -> tuple[Rows, Files, str]:
    if limit <= 0:
        raise OptionError("scaling", limit, "a number of seconds above 0")
    options = {option: value for option, value in arguments.items() if value is not None and value is not False}
    names = options.pop("estimators", list(SCALED))
    settings = {setting: options.pop(setting) for setting in SETTINGS if setting in options}
    if options:
        raise OptionError(f"{flag(next(iter(options)))} does not go with --scaling, which has rings of its own")
    _refuse("", names, {}, settings)
    with warnings.catch_warnings(record=True) as noted:
        warnings.simplefilter("always")
        all_costs = costs(seed, names, settings, limit)
    rows = [("world", f"circuit, seed {seed}"), *scaling_rows(all_costs)]
    rows += [("note", str(note.message)) for note in noted]

    def files() -> Contents:
        from nls.plot.filters import power_laws

        report = {"seed": seed, "settings": settings, "estimators": [asdict(cost) for cost in all_costs]}
        contents = _pictured("scaling", power_laws(panels(all_costs), FITTED, "landmarks"), report)
        return contents, "scaling.png: seconds against landmarks.\nscaling.json: the same, s.\n"

    return rows, files, "Circuits: rings with 100 to 12,800 landmarks, each gone round once and 20 steps more."


def _many(
    world: LandmarkWorld, head: Rows, request: dict[str, Any], names: list[str], count: int, file: str | None
) -> Estimated:
    seeds = range(request["seed"], request["seed"] + count)
    given = {"scene": request["world"], "estimators": names} | {k: request[k] for k in ("options", "settings")}
    function = partial(of_seed, **given)
    with warnings.catch_warnings(record=True) as noted:
        warnings.simplefilter("always")
        try:
            records, failed = dict(zip(seeds, runs(function, seeds, resume=file, progress=True), strict=True)), None
        except FailedRunsError as error:
            if not error.records:
                raise
            records, failed = error.records, error
    rows = monte_carlo_rows(seeds, list(records.values()), world.truth.stack("x").manifold.dim)
    if failed is not None:
        seeds_failed = f"seed{'' if len(failed.failures) == 1 else 's'} {some(list(failed.failures), LISTED)}"
        rows.append(("failed", f"{seeds_failed}, left out of the means"))
    rows += [("note", str(note.message)) for note in noted]

    def files() -> Contents:
        from nls.cli.outputs import json_text

        report = {**request, "runs": [{"seed": seed, **record} for seed, record in records.items()]}
        if failed is not None:
            report["failed"] = [{"seed": seed, "error": sentence(error)} for seed, error in failed.failures.items()]
        return {"runs.json": json_text(report).encode()}, "runs.json: options, and the errors of every seed, m.\n"

    return [*head, *rows], files, world.description, failed


def _pictured(name: str, figure: Any, report: dict[str, Any]) -> dict[str, bytes]:
    """A picture and its numbers: ``name.png`` and ``name.json``."""
    from nls.cli.outputs import json_text
    from nls.plot.picture import drawn

    return {f"{name}.png": drawn(f"{name}.png", figure), f"{name}.json": json_text(report).encode()}


def _refuse(scene: str, names: list[str], options: dict[str, Any], settings: dict[str, int]) -> None:
    """The options that were given twice, or would do nothing."""
    if len(set(names)) < len(names):
        raise OptionError("estimators", " ".join(names), "every one once")
    for option in options:
        if option not in parameters(SCENES[scene]):
            raise OptionError(
                f"{flag(option)} is no option of the world {scene}; leave it out, or choose another world"
            )
    for setting in settings:
        users = SETTINGS[setting][0]
        if not set(users) & set(names):
            belongs = f"{flag(setting)} belongs to {' or '.join(users)}, not to {' or '.join(names)}"
            raise OptionError(f"{belongs}; leave it out, or choose another estimator")


def _add_settings(sub: argparse.ArgumentParser) -> None:
    for setting, (_, meaning) in SETTINGS.items():
        sub.add_argument(flag(setting), type=whole_number, default=argparse.SUPPRESS, metavar="N", help=meaning)
    sub.add_argument("--runs", type=run_number, metavar="N", help="number of seeds, from --seed on, on all cores")
    sub.add_argument("--resume", metavar="FILE", help="file for the records of --runs; a later run continues it")


def run_number(text: str) -> int:
    """A whole number of at least 1."""
    if (value := whole_number(text)) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is below 1; give the number of seeds")
    return value
