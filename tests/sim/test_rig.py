"""The rig of camera and sonar: the scene as it is defined, its noise, its start, and what calibration gives."""

from __future__ import annotations

from math import radians

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

import sim
from models import SE3
from models.errors import GraphError, OptionError, SingularGeometryError
from models.sensors import Camera
from nls import kinds
from tests.combinations import for_all
from tests.sim.scenes import made

Array = npt.NDArray[np.float64]
same = np.testing.assert_allclose
x, l, s = kinds("x", "l", "s")


def small(seed: int = 0, **options: object) -> sim.Rig:
    return made("rig", seed, **options)  # type: ignore[no-any-return]


def expected_poses(points: Array) -> list[Array]:
    """Camera to world, as 4 x 4 matrices, one after the other, from the definition of the path."""
    out = []
    for k in range(20):
        a = k / 19
        position = np.array([4 * np.sin(1.2 * a), -1.5 * np.sin(2.2 * a), 3 * (1 - np.cos(1.2 * a))])
        forward = points.mean(axis=0) + np.array([0.8 * np.sin(5 * a), 0.5 * np.cos(4 * a), 0.0]) - position
        forward /= np.linalg.norm(forward)
        down = np.array([0.0, 1.0, 0.0]) - forward[1] * forward  # what is left of the world's down across the axis
        down /= np.linalg.norm(down)
        level = np.column_stack([np.cross(down, forward), down, forward])
        T = np.eye(4)
        T[:3, :3] = level @ Rotation.from_euler("z", 0.25 * np.sin(6 * a)).as_matrix()
        T[:3, 3] = position
        out.append(T)
    return out


def test_the_scene_is_as_defined() -> None:
    rig = sim.rig(np.random.default_rng(3))
    assert (rig.poses, rig.points, rig.name, rig.seed) == (20, 600, "rig", 3)
    assert rig.graph.fixed == [x[0]]
    same(rig.truth[x[0]], SE3.identity()[0], atol=1e-12)
    path = np.array([T[:3, 3] for T in expected_poses(np.full((1, 3), 8.0))])  # whatever the cameras look at
    turn, _ = Rotation.align_vectors(path, rig.truth[x][:, :3])  # into the world; the first camera is at its origin
    points = turn.apply(rig.truth[l])
    for X, T in zip(rig.truth[x], expected_poses(points), strict=True):
        same(turn.apply(X[:3]), T[:3, 3], atol=1e-9)
        same((turn * Rotation.from_quat(X[3:])).as_matrix(), T[:3, :3], atol=1e-9)
    for axis, (low, high) in enumerate([(-4, 4), (-3, 3), (5, 11)]):
        assert low <= points[:, axis].min() < low + 0.1
        assert high - 0.1 < points[:, axis].max() <= high
    same(points.mean(axis=0), [0, 0, 8], atol=0.3)


def test_the_sonar_is_where_it_is_defined_to_be() -> None:
    """R_sk = nominal Exp(0.05, -0.03, 0.04) and p_sk, the camera in the frame of the sonar."""
    nominal = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    R_sk = nominal @ Rotation.from_rotvec([0.05, -0.03, 0.04]).as_matrix()
    back = SE3.inverse(small().truth[s])
    same(back[0, :3], [0.10, -0.15, 0.30], atol=1e-14)
    same(SE3.rotation(back)[0], R_sk, atol=1e-14)
    for seed in range(5):
        guess = SE3.between(small(seed).truth[s], small(seed).start[s])
        assert np.linalg.norm(guess[0, :3]) == pytest.approx(0.05, rel=1e-9)
        assert Rotation.from_quat(guess[0, 3:]).magnitude() == pytest.approx(radians(3), rel=1e-9)
    turns = [SE3.log(SE3.between(small(k).truth[s], small(k).start[s]))[0, 3:] for k in range(5)]
    assert np.linalg.matrix_rank(np.array(turns), tol=1e-3) == 3  # about another axis each time


@for_all(options=[{}, {"poses": 7, "points": 300, "views": 3}])
def test_everything_is_measured_once_and_is_in_the_image(options: dict[str, int]) -> None:
    """Exact measurements by hand, pair by pair; noise is within its bounds and evenly spread over them."""
    exact, noisy = (sim.rig(np.random.default_rng(4), noise_scale=k, **options) for k in (0.0, 1.0))
    views = options.get("views", exact.poses)
    images, contacts = exact.images, exact.contacts
    assert images.keys[:2] == contacts.keys[:2]
    i, k = images.keys[0].numbers, images.keys[1].numbers
    assert len(set(zip(i.tolist(), k.tolist(), strict=True))) == len(i) == views * exact.points
    assert (np.bincount(k) == views).all()
    X, L, O = exact.truth[x], exact.truth[l], exact.truth[s][0]
    for row in np.linspace(0, len(i) - 1, 40).astype(int):
        p = Rotation.from_quat(X[i[row], 3:]).inv().apply(L[k[row]] - X[i[row], :3])
        same(images.z[row], [600 * p[0] / p[2] + 640, 600 * p[1] / p[2] + 480], atol=1e-9)
        q = Rotation.from_quat(O[3:]).inv().apply(p - O[:3])
        same(contacts.z[row], [np.linalg.norm(q), np.arctan2(q[1], q[0])], atol=1e-12)
        assert p[2] > 0
    assert (images.z >= 0).all()
    assert (images.z <= [1280, 960]).all()
    assert (np.abs(contacts.z[:, 1]) < radians(70)).all()
    half = np.array([5.0, 5.0, 0.05, radians(5)])
    noise = np.hstack([noisy.images.z - images.z, noisy.contacts.z - contacts.z]) / half
    assert (np.abs(noise) <= 1).all()
    same(noise.std(axis=0), 1 / np.sqrt(3), rtol=4 / np.sqrt(len(noise)))
    same(np.corrcoef(noise.T), np.eye(4), atol=4.5 / np.sqrt(len(noise)))
    sigmas = [1 / f.noise.sqrt_information(1, f.names(f.measured(3))).ravel() for f in exact.graph.factors]
    same(np.concatenate(sigmas), half / np.sqrt(3))


def test_errors_by_hand() -> None:
    """A motion of everything is no error; a shift of the cameras against the points is; the sonar is not aligned."""
    rig = small(1)
    M = SE3.exp(np.array([[3.0, -2, 1, 0.5, 0.4, -2.0]]))
    moved = rig.truth.replaced({x: SE3.compose(M, rig.truth[x]), l: SE3.act(M, rig.truth[l])})
    exact = rig.errors(moved)
    assert max(exact.poses, exact.points, exact.extrinsic_m, exact.extrinsic_rad) < 1e-7
    off = SE3.compose(rig.truth[s], SE3.exp(np.array([[0, 0, 0, 0, 0.2, 0]])))
    off[:, :3] += [0.03, 0.0, 0.04]
    errors = rig.errors(moved.replaced({s: off}))
    same([errors.extrinsic_m, errors.extrinsic_rad], [0.05, 0.2], atol=1e-9)
    out = rig.truth[l]
    out[7] += [0.0, 0.3, 0.4]
    errors = rig.errors(rig.truth.replaced({l: out}))
    assert errors.points == pytest.approx(0.5 / np.sqrt(60), rel=0.02)  # one of sixty; the alignment takes a little
    assert errors.poses < 0.5 / 60 * 3
    assert "alignment: rigid, of both together" in str(errors)
    with pytest.raises(GraphError, match=r"errors: .* expected the same"):
        rig.errors(small(1, points=61).truth)


def test_poses_that_share_too_few_points() -> None:
    with pytest.raises(SingularGeometryError, match=r"x\d+"):
        small(views=1)


def test_a_rig_of_your_own() -> None:
    """Given poses, points, camera, mounting and noise are the truth; a camera measures what is in its image."""
    poses = SE3.exp([[0.4 * k, 0, 0, 0, 0.1 * k, 0] for k in range(5)])
    points = np.random.default_rng(0).uniform([-1, -1, 3], [1.5, 1, 5], (40, 3))
    camera = Camera(focal=(400.0, 400.0), center=(320.0, 240.0), size=(640, 480))
    mounted = SE3.exp([0.2, 0, 0.1, 1.2, -1.2, 1.2])
    noise = {"range": 0.02, "u": 1.0}
    mine = sim.rig(np.random.default_rng(1), poses, points, camera=camera, sonar=mounted, noise=noise)
    same(mine.truth[x], poses, atol=1e-12)
    same(mine.truth[l], points)
    same(mine.truth[s[0]], mounted, atol=1e-12)
    seen = {(i, k) for i in range(5) for k in range(40) if camera.sees(SE3.act(SE3.inverse(poses[i]), points[k])[None])}
    i, k = (key.numbers.tolist() for key in mine.images.keys[:2])
    assert set(zip(i, k, strict=True)) == seen
    assert len(seen) < 5 * 40  # some are out of the image
    exact = sim.rig(np.random.default_rng(1), poses, points, noise_scale=0, camera=camera, sonar=mounted, noise=noise)
    off = np.abs(np.hstack([mine.images.z - exact.images.z, mine.contacts.z - exact.contacts.z])).max(axis=0)
    half = np.array([1.0, 5.0, 0.02, radians(5)])
    assert ((0.9 * half < off) & (off <= half)).all()
    same(exact.errors(exact.graph.optimize(exact.start).values).extrinsic_m, 0, atol=1e-8)
    with pytest.raises(GraphError, match=r"1 of 41 points are in no image, the first in row 40"):
        sim.rig(np.random.default_rng(1), poses, np.vstack([points, [0, 0, -9]]), camera=camera)
    for arguments, named in (((poses, 40), "poses, points: "), ((poses, points, 3), "views: ")):
        with pytest.raises(OptionError, match=named):
            sim.rig(np.random.default_rng(1), *arguments)
    with pytest.raises(OptionError, match="noise: "):
        small(noise={"ragne": 0.1})
