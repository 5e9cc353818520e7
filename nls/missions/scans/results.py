"""A map from scans as CSV files: the keyframes and how well each is known, the points in the world, the closures."""

from __future__ import annotations

import numpy as np

from models.algebra import Array, Numbers
from nls.missions.charts.ply import ply_text
from nls.missions.folder.table import csv_text
from nls.missions.results import or_empty
from nls.missions.scans import Matches, Verdict
from nls.missions.scans.folder import ScanReport
from nls.missions.scans.scans import in_world

__all__ = ["CLOSURES", "MAP", "TRAJECTORY", "WORDS", "closures_text", "map_text", "points_text", "trajectory_text"]

POSE = ("x_m", "y_m", "yaw_rad")
SIGMAS = tuple(f"sigma_{name}" for name in POSE)
CORRELATIONS = ("correlation_x_y", "correlation_x_yaw", "correlation_y_yaw")
TRAJECTORY = ("keyframe", "time_s", *POSE, *SIGMAS, *CORRELATIONS)
MAP = ("x_m", "y_m", "keyframe", "intensity")
CLOSURES = ("keyframe_i", "keyframe_j", *POSE, *SIGMAS, "score", "ratio", "edge", "spread_m", "verdict")
WORDS = {
    Verdict.NO_FIT: "no fit",
    Verdict.AMBIGUOUS: "ambiguous",
    Verdict.AT_THE_RIM: "at the rim",
    Verdict.WIDE: "wide",
}
KEPT, CONTRADICTED = "kept", "contradicted"


def trajectory_text(poses: Array, report: ScanReport, covariance: Array | None) -> bytes:
    """trajectory.csv: every keyframe, its standard deviations and correlations; empty cells where they are not known.

    Parameters
    ----------
    poses : (count, 3) x, y, m, and yaw, rad.
    report : with numbers and times of the keyframes.
    covariance : (count, 3, 3) of x, y and yaw along the axes of the world; None without one.
    """
    known = np.full((len(poses), 6), np.nan)
    if covariance is not None:
        sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        one = np.where(sigma > 0, sigma, 1.0)
        correlation = (covariance / (one[:, :, None] * one[:, None, :]))[:, [0, 0, 1], [1, 2, 2]]
        known = np.column_stack([sigma, correlation])
    return csv_text(TRAJECTORY, report.numbers, report.vertex_times["x"], poses, or_empty(known))


def map_text(poses: Array, report: ScanReport) -> bytes:
    """map.csv: every point in the world and its keyframe; its intensity where there is one."""
    points, numbers = in_world(poses, report.scans), report.numbers[report.scans.keyframe]
    if report.intensity is None:
        return csv_text(MAP[:-1], points, numbers)
    return csv_text(MAP, points, numbers, report.intensity)


def points_text(poses: Array, report: ScanReport) -> bytes:
    """map.ply: the keyframes and the points, at z = 0."""
    points, numbers = in_world(poses, report.scans), report.numbers[report.scans.keyframe]
    parts = [("keyframe", report.numbers, poses[:, :2]), ("point", numbers, points)]
    return ply_text(parts, "x, y and z = 0 of the world, m", "; number: of the keyframe")


def closures_text(matches: Matches, numbers: Numbers) -> bytes:
    """closures.csv: every candidate of the last round and what became of it.

    Parameters
    ----------
    matches : of the round.
    numbers : of the keyframes in the file.
    """
    sigma = np.sqrt(np.diagonal(matches.covariance, axis1=1, axis2=2))
    quality = np.column_stack([matches.score, matches.ratio, matches.edge, matches.spread])
    return csv_text(
        CLOSURES, numbers[matches.i], numbers[matches.j], matches.pose, sigma, quality, verdict_words(matches)
    )


def verdict_words(matches: Matches) -> list[str]:
    """The fate of every candidate (n,): kept, contradicted by the others, or why it was no closure."""
    accepted = [KEPT if kept else CONTRADICTED for kept in matches.kept.tolist()]
    return [WORDS.get(Verdict(v), word) for v, word in zip(matches.verdict.tolist(), accepted, strict=True)]
