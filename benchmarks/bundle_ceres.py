"""The Ceres side of bundle.py: run by a Python that has pyceres and pycolmap, and needs nothing else.

    python benchmarks/bundle_ceres.py PROBLEM.npz LINEAR_SOLVER THREADS

COLMAP's bundle adjuster builds the problem in C++: its camera RADIAL is the one of the data sets, f (1 + k1 |p|^2 +
k2 |p|^4) p, derivatives by Ceres' automatic differentiation. Axes y and z of the camera and y of the image are turned.
Prints JSON: the start chi2, and after every step processor time, wall time and chi2. Only Ceres' own solve is timed.
"""

from __future__ import annotations

import json
import sys
from time import perf_counter, process_time
from typing import Any

import numpy as np


def adjuster(given: dict[str, Any]) -> Any:
    """COLMAP's adjuster of all cameras, points and lenses but the pose of camera 0."""
    import pycolmap

    turn, scene = np.diag([1.0, -1.0, -1.0]), pycolmap.Reconstruction()
    camera, point = given["camera"], given["point"]
    place = np.empty(len(camera), dtype=int)  # of every observation in its image
    for c, ((f, k1, k2), R, t) in enumerate(zip(given["K"], given["R"], given["t"], strict=True)):
        lens = {"model": "RADIAL", "width": 1, "height": 1, "params": [f, 0.0, 0.0, k1, k2]}
        scene.add_camera_with_trivial_rig(pycolmap.Camera(**lens, camera_id=c + 1))
        seen = np.flatnonzero(camera == c)
        place[seen] = np.arange(len(seen))
        pixels = given["z"][seen] * [1.0, -1.0]
        image = pycolmap.Image(name=str(c), keypoints=pixels, camera_id=c + 1, image_id=c + 1)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(turn @ R), turn @ t)
        scene.add_image_with_trivial_frame(image, pose)
    order = np.argsort(point, kind="stable")
    for position, of_this in zip(given["P"], np.split(order, np.flatnonzero(np.diff(point[order])) + 1), strict=True):
        track = pycolmap.Track()
        for o in of_this:
            track.add_element(int(camera[o]) + 1, int(place[o]))
        scene.add_point3D(position, track)
    config = pycolmap.BundleAdjustmentConfig()
    for c in range(len(given["K"])):
        config.add_image(c + 1)
    config.set_constant_rig_from_world_pose(1)
    found = pycolmap.create_default_ceres_bundle_adjuster(pycolmap.BundleAdjustmentOptions(), config, scene)
    return found, scene  # which has to outlive it


def main() -> int:
    import pyceres

    path, solver, threads = sys.argv[1:]
    with np.load(path) as arrays:
        bundle, _scene = adjuster(dict(arrays))
    trace: list[tuple[float, float, float]] = []

    class Record(pyceres.IterationCallback):  # type: ignore[misc]
        def __call__(self, step: Any) -> Any:
            if step.step_is_successful:
                trace.append((process_time() - cpu, perf_counter() - wall, 2 * step.cost))
            return pyceres.CallbackReturnType.SOLVER_CONTINUE

    options, summary, record = pyceres.SolverOptions(), pyceres.SolverSummary(), Record()
    options.linear_solver_type = getattr(pyceres.LinearSolverType, solver)
    options.preconditioner_type = pyceres.PreconditionerType.SCHUR_JACOBI
    options.num_threads, options.max_num_iterations, options.function_tolerance = int(threads), 200, 1e-6
    options.gradient_tolerance = options.parameter_tolerance = 1e-15  # the cost alone decides, as for the others
    options.minimizer_progress_to_stdout, options.logging_type = False, pyceres.LoggingType.SILENT
    options.callbacks = [record]
    cpu, wall = process_time(), perf_counter()
    pyceres.solve(options, bundle.problem, summary)
    seconds = process_time() - cpu, perf_counter() - wall
    refused = summary.num_unsuccessful_steps
    print(json.dumps({"trace": trace, "seconds": seconds, "refused": refused, "version": pyceres.__ceres_version__}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
