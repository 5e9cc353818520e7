r"""Points that an imaging sonar detects in a scene: from images, or drawn from their rates, 10 to 50 times faster.

An echo of mean power S over the noise fluctuates, as that of a rough wall does. At a false-alarm rate P_fa it is
detected with the probability

    P_d = P_fa^(1 / (1 + S cos^2(i)))

at an angle of incidence i (Lambert). False alarms are evenly spread over beams and bins, P_fa of all cells.

Source: M. Richards, Fundamentals of Radar Signal Processing, 2014, section 6.3 (Swerling 1).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.algebra import Array, wrap
from models.sensors import BLUEVIEW_M900, ImagingSonar
from nls.missions.scans import Scans
from nls.missions.sonar import detect
from sim.scene import Scene, slices
from sim.sonar_images import sonar_image

__all__ = ["SONAR", "drawn", "imaged"]

SONAR = replace(BLUEVIEW_M900, window=(0.5, 50.5))
SPREAD = 2.0  # beams and bins, standard deviation of an echo: 0.34 deg and 0.1 m
THIN = 0.5  # m
BLOCK = 64  # keyframes drawn at once: memory does not grow with their number
GUARD, TRAIN = 10, 20  # bins


def drawn(
    rng: np.random.Generator, scene: Scene, poses: Array, sonar: ImagingSonar, signal: float, false_alarms: float
) -> Scans:
    """Scans of the first surfaces, of rocks and of nothing, with their rates."""
    near, far = sonar.window
    snr = 10 ** (signal / 10)
    azimuth = ((np.arange(sonar.beams) + 0.5) / sonar.beams - 0.5) * sonar.fan
    echoes = []
    for rows in slices(len(poses), BLOCK):
        hits = scene.hits(poses[rows], azimuth)
        k, beam = np.nonzero(rng.random(hits.range.shape) < false_alarms ** (1 / (1 + snr * hits.cosine**2)))
        echoes.append(np.column_stack([rows.start + k, hits.range[k, beam], azimuth[beam]]))
    for rows in slices(len(poses) if len(scene.rocks) else 0, BLOCK):
        to = scene.rocks - poses[rows, None, :2]  # (n, rocks, 2)
        r, bearing = np.hypot(to[..., 0], to[..., 1]), wrap(np.arctan2(to[..., 1], to[..., 0]) - poses[rows, 2:])
        visible = (np.abs(bearing) <= sonar.fan / 2) & (r <= scene.hits(poses[rows], bearing).range)
        k, rock = np.nonzero(visible & (rng.random(r.shape) < false_alarms ** (1 / (1 + snr))))
        echoes.append(np.column_stack([rows.start + k, r[k, rock], bearing[k, rock]]))
    z = np.concatenate(echoes)
    z = z[np.isfinite(z[:, 1])]
    cell = np.array([(far - near) / sonar.bins, sonar.fan / sonar.beams])
    z[:, 1:] += SPREAD * cell * rng.standard_normal((len(z), 2))
    false = np.repeat(np.arange(len(poses)), rng.poisson(false_alarms * sonar.beams * sonar.bins, len(poses)))
    uniform = rng.random((len(false), 2))
    alarms = np.column_stack([false, near + (far - near) * uniform[:, 0], (uniform[:, 1] - 0.5) * sonar.fan])
    z = np.concatenate([z[(near <= z[:, 1]) & (z[:, 1] <= far) & (np.abs(z[:, 2]) <= sonar.fan / 2)], alarms])
    z = z[rng.permutation(len(z))]
    p, keyframe = z[:, 1:2] * np.column_stack([np.cos(z[:, 2]), np.sin(z[:, 2])]), z[:, 0].astype(np.intp)
    first = np.unique(np.column_stack([keyframe, np.floor(p / THIN)]), axis=0, return_index=True)[1]
    return Scans(p[first], keyframe[first], len(poses))


def imaged(
    rng: np.random.Generator, scene: Scene, poses: Array, sonar: ImagingSonar, signal: float, false_alarms: float
) -> Scans:
    """Scans of what `nls.missions.sonar.detect` makes of an image at every pose.

    Greatest-of takes the level of the noise before a surface, as the rates do. Smallest-of takes that of the shadow
    behind it, and finds 35 to 110 % more points than are drawn.
    """
    background = np.sqrt(0.5 * 10 ** (-signal / 10))  # of echoes of amplitude 1
    scans = []
    for pose in poses:  # images, not measurements: 768 beams of 1000 bins each
        image = sonar_image(scene, sonar, rng, background=background, spread=SPREAD, pose=pose)
        scans.append(detect(image, sonar, "goca", false_alarms, TRAIN, GUARD, thin=THIN).points)
    return Scans(np.concatenate(scans), np.repeat(np.arange(len(poses)), [len(p) for p in scans]), len(poses))
