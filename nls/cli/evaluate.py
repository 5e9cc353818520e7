"""``nls evaluate``: an estimated trajectory beside the true one."""

import argparse
import shlex
from typing import Any

import numpy as np

import nls
from models import SO3
from models.advice import Advice
from models.algebra import Array, Index
from nls.cli.outputs import refuse_unwritable, say, write_json
from nls.metrics import TrajectoryError, ate, circles, matched, rpe
from nls.missions.folder.poses import FILES, TRUE_FILES, Poses, read_poses

SCHEMA = "evaluate 1"
LEVEL_RAD = 1e-9  # rad, below which a pose is one of the plane
TURNED_OVER = (
    "the alignment {} turned the track upside down. Causes: (1) one track is mirrored, (2) one file has z up and the "
    "other z down, (3) the track is nearly straight, so its roll is not determined. The ATE of a level track does not "
    "show it. Compare with --align yaw, which keeps the vertical. If that fits worse, change the signs of y and "
    "yaw of one file, or its frame"
)
ONE_ANGLE, SPREAD = 0.9, 0.5  # mean resultant lengths of angles that are one, and of angles that are spread


def evaluate(options: argparse.Namespace) -> int:
    """Read both, match, align, compare, print; returns the exit status."""
    distances = _distances(options.distances)
    refuse_unwritable({"--json": options.json}, options.file, options.truth)
    read = []
    for file, names in ((options.file, FILES), (options.truth, TRUE_FILES)):
        options.phase.begin(f"while reading {file}")
        try:
            read.append(read_poses(file, names))
        except nls.GraphFileError as error:
            if error.advice:  # options of the commands that read graphs
                error.advise(Advice("convert first", (shlex.quote(file),)))
            raise
    estimate, truth = read
    options.phase.begin(f"while comparing {options.file} with {options.truth}")
    record = compared(estimate, truth, options.align, distances, options.tolerance)
    if record["turned_over"]:
        say(f"nls: warning: {options.file}: {TURNED_OVER.format(options.align)}", error=True)
    options.phase.now("while writing the report")
    write_json(record, options.json)
    if options.json != "-":
        say("\n".join(lines(record)))
    return 0


def _distances(text: str) -> list[float]:
    """The distances of ``--distances``."""

    try:
        distances = [float(word) for word in text.split(",")]
    except ValueError:
        distances = [0.0]
    if not all(0 < distance < np.inf for distance in distances):
        raise nls.OptionError("--distances", text, "meters above 0 with commas between, such as 10,50,100")
    return distances


def compared(
    estimate: Poses, truth: Poses, align: str, distances: list[float], tolerance: float | None
) -> dict[str, Any]:
    """The report for programs.

    Parameters
    ----------
    estimate, truth : as read.
    align : one of `nls.metrics.ALIGNMENTS`.
    distances : of the relative errors, m.
    tolerance : for matching by time, s.

    Raises
    ------
    GraphError
        Poses that cannot be matched.
    SingularGeometryError
        Positions that do not determine the alignment.
    """
    how, rows, P, Q = _pairs(estimate, truth, tolerance)
    error = ate(P, Q, align)
    unknown = _no_relative_error(estimate, truth, P, Q)
    return {
        "schema": SCHEMA,
        "estimate": estimate.path,
        "truth": truth.path,
        "estimated_poses": len(estimate.X),
        "true_poses": len(truth.X),
        **how,
        "align": align,
        "scale": error.scale,
        "T": error.T.tolist(),
        **_motion(error.T),
        "ate": {
            "rmse_m": error.rmse,
            "mean_m": error.mean,
            "largest_m": error.largest,
            "rotation_rmse_deg": float(np.degrees(error.rotation)) if estimate.oriented and truth.oriented else None,
        },
        "horizontal": circles(error.errors),
        "vertical_rmse_m": float(np.sqrt(np.mean(np.square(error.errors[:, 2])))),
        "rpe": [
            {
                "distance_m": pair.distance,
                "pairs": pair.pairs,
                "way_m": pair.way,
                "translation_percent": 100 * pair.translation,
                "rotation_deg_m": float(np.degrees(pair.rotation)),
            }
            for pair in ([] if unknown else rpe(P, Q, distances))
        ],
        "rpe_unknown": unknown,
        "squared_error_over_variance": _consistency(estimate, rows, error),
    }


def _motion(T: Array) -> dict[str, Any]:
    """The alignment (7,) as a translation, a yaw, and the angle between the verticals before and after it."""
    x, y, z, w = T[3:].tolist()
    tilt = float(np.degrees(2 * np.arctan2(np.hypot(x, y), np.hypot(z, w))))
    yaw = float(np.degrees(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))))
    return {"translation_m": T[:3].tolist(), "yaw_deg": yaw, "tilt_deg": tilt, "turned_over": tilt > 90}


def _pairs(estimate: Poses, truth: Poses, tolerance: float | None) -> tuple[dict[str, Any], Index, Array, Array]:
    """How poses were matched, the rows of the estimate, and the poses of both in the order of time."""
    out: dict[str, Any] = {"outside": 0, "gaps": 0, "tolerance_s": None}
    if estimate.numbers is not None and truth.numbers is not None:
        numbers, rows, k = np.intersect1d(estimate.numbers, truth.numbers, return_indices=True)
        order = np.argsort(numbers if truth.times is None else truth.times[k], kind="stable")
        rows, k = rows[order], k[order]
        P, Q, out["matched_by"] = estimate.X[rows], truth.X[k], "number"
        if not len(rows):
            raise nls.GraphError(f"{estimate.path} and {truth.path} have no number i in common")
    elif estimate.times is not None and truth.times is not None:
        pairs = matched(estimate.times, estimate.X, truth.times, truth.X, tolerance)
        rows, P, Q, out["matched_by"] = pairs.rows, pairs.estimate, pairs.truth, "time"
        out |= {"outside": pairs.outside, "gaps": pairs.gaps, "tolerance_s": pairs.tolerance}
    else:
        both, ways = (estimate, truth), ("times", "numbers")
        kinds = [" and ".join(way for way in ways if getattr(poses, way) is not None) for poses in both]
        if any(kinds):
            has = "; ".join(f"{poses.path} has {kind or 'rows'} alone" for poses, kind in zip(both, kinds, strict=True))
            raise nls.GraphError(
                f"{has}. Expected times in both, numbers in both, or rows alone in both: KITTI files; "
                "nls convert GRAPH OUT.tum takes the numbers of poses without times for times"
            )
        if len(estimate.X) != len(truth.X):
            raise nls.GraphError(
                f"{estimate.path} has {len(estimate.X)} poses, {truth.path} {len(truth.X)}; without times and numbers "
                "they are matched row by row, which takes the same count"
            )
        rows, P, Q, out["matched_by"] = np.arange(len(truth.X)), estimate.X, truth.X, "row"
    if tolerance is not None and out["matched_by"] != "time":
        nothing = f"nothing: the poses are matched by {out['matched_by']}, not by time"
        raise nls.OptionError("--tolerance", tolerance, nothing)
    return {**out, "matched": len(rows)}, rows, P, Q


def _no_relative_error(estimate: Poses, truth: Poses, P: Array, Q: Array) -> str | None:
    """Why there is no error of relative poses: a file without headings, or headings of two conventions; else None."""
    for poses in (estimate, truth):
        if not poses.oriented:
            return f"{poses.path} has no headings"
    if headings_opposed(P, Q):
        return f"the yaws of {estimate.path} and {truth.path} have opposite senses; expected one convention"
    return None


def headings_opposed(P: Array, Q: Array) -> bool:
    """Whether poses (n, 7) of the plane turn to the right where others (n, 7) turn to the left.

    Yaws of one sense have one difference, those of opposite senses one sum, but for errors. The length of the mean of
    exp(i angle) is 1 where all angles are one, and near 0 where they are spread over the circle.
    """
    p, q = SO3.log(P[:, 3:]), SO3.log(Q[:, 3:])
    if np.abs(np.concatenate([p[:, :2], q[:, :2]])).max(initial=0.0) > LEVEL_RAD:
        return False
    difference, total = (abs(np.exp(1j * angle).mean()) for angle in (p[:, 2] - q[:, 2], p[:, 2] + q[:, 2]))
    return bool(total > ONE_ANGLE and difference < SPREAD)


def _consistency(estimate: Poses, rows: Index, error: TrajectoryError) -> dict[str, float] | None:
    """Mean of (error / sigma)^2 along each axis, where the estimate has sigmas and nothing was aligned."""
    if estimate.sigmas is None or error.align != "none":
        return None
    sigma = estimate.sigmas[rows]
    squares = np.square(np.divide(error.errors, sigma, out=np.full(sigma.shape, np.nan), where=sigma > 0))
    known = np.isfinite(squares)
    if not known.any(axis=0).all():
        return None
    return dict(zip("xyz", (np.where(known, squares, 0.0).sum(axis=0) / known.sum(axis=0)).tolist(), strict=True))


def lines(record: dict[str, Any]) -> list[str]:
    """The table, from the report for programs."""
    ate, level = record["ate"], record["horizontal"]
    left = [f"{record[name]} {words} left out" for name, words in LEFT.items() if record[name]]
    moved = ", ".join(f"{meters:.4g}" for meters in record["translation_m"])
    motion = f", moved by ({moved}) m, turned by {record['yaw_deg']:.4g} deg" if record["align"] != "none" else ""
    motion += f", tilted by {record['tilt_deg']:.3g} deg" if record["tilt_deg"] > LEVEL_RAD else ""
    motion += f", scale {record['scale']:.6g}" if record["align"] == "similarity" else ""
    rotation = f"; rotation {ate['rotation_rmse_deg']:.4g} deg rmse" if ate["rotation_rmse_deg"] is not None else ""
    out = [
        f"estimate    {record['estimate']}: {record['estimated_poses']} poses",
        f"truth       {record['truth']}: {record['true_poses']} poses",
        f"matched     {record['matched']} poses by {record['matched_by']}"
        + (f", gaps of the truth up to {record['tolerance_s']:.4g} s bridged" if record["tolerance_s"] else "")
        + "".join(f"; {words}" for words in left),
        f"alignment   {record['align']}{motion}",
        f"ATE         {ate['rmse_m']:.4g} m rmse, {ate['mean_m']:.4g} m mean, {ate['largest_m']:.4g} m at most"
        + rotation,
        f"horizontal  CEP {level['cep50_m']:.4g} m (50 %), {level['cep95_m']:.4g} m (95 %), 2DRMS "
        f"{level['drms2_m']:.4g} m; vertical {record['vertical_rmse_m']:.4g} m rmse",
    ]
    for pair in record["rpe"]:
        errors = f"{pair['translation_percent']:.3g} %, {pair['rotation_deg_m']:.3g} deg/m ({pair['pairs']} pairs"
        longer = f", {pair['way_m']:.4g} m in the mean)" if pair["way_m"] > 1.05 * pair["distance_m"] else ")"
        words = errors + longer if pair["pairs"] else "the track is shorter"
        out.append(f"RPE         over {pair['distance_m']:g} m: {words}")
    if record["rpe_unknown"]:
        out.append(f"RPE         none: {record['rpe_unknown']}")
    if (ratio := record["squared_error_over_variance"]) is not None:
        means = ", ".join(f"{axis} {value:.3g}" for axis, value in ratio.items())
        out.append(f"sigmas      mean of (error / sigma)^2: {means}; 1 expected")
    return out


LEFT = {"outside": "before or after the truth", "gaps": "in gaps of the truth"}
