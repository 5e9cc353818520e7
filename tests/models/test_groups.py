"""Conformity of every Lie group: a group found in `models.manifolds` is tested without being listed anywhere."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

import models.manifolds
from models import SE3, SO3, LieGroup, Measured, R
from models.algebra import Array
from models.errors import GraphError, OptionError
from tests.combinations import for_all

MODULES = [
    importlib.import_module(m.name) for m in pkgutil.walk_packages(models.manifolds.__path__, "models.manifolds.")
]
FOUND = [value for module in MODULES for value in vars(module).values() if isinstance(value, LieGroup)]
GROUPS = list(dict.fromkeys([*FOUND, R(1), R(2), R(3), R(7), Measured("range", "bearing")]))
ANGLES = [0.0, 1e-9, 1e-7, 1e-4, 0.1, 1.0, 3.0, np.pi - 1e-7, np.pi - 1e-9]
LENGTHS = ["x", "y", "z", *(f"c{k}" for k in range(7)), "range"]  # components that are lengths or plain numbers
AXES = ["roll", "pitch", "yaw", "bearing"]  # components that are angles, about x, y and z
SHAPES: list[tuple[int, ...]] = [(), (1,), (3, 1, 2)]
STEP = 1e-5
OTHER_FORMS: dict[str, list[Callable[[Array], Array]]] = {  # other stored numbers of the same element
    "SO2": [lambda X: X + 2 * np.pi, lambda X: X - 4 * np.pi],
    "SE2": [lambda X: X + np.array([0, 0, 2 * np.pi]), lambda X: X - np.array([0, 0, 4 * np.pi])],
    "(range, bearing)": [lambda X: X + np.array([0, 2 * np.pi])],
    "SO3": [lambda X: -X, lambda X: 1.001 * X],
    "SE3": [lambda X: X * [1, 1, 1, -1, -1, -1, -1], lambda X: X * [1, 1, 1, *[-0.999] * 4]],
}

every_group = pytest.mark.parametrize("group", GROUPS, ids=str)
seeds = st.integers(0, 2**32 - 1)


def turning(group: LieGroup) -> list[int]:
    """Which tangent components are angles."""
    unknown = set(group.components) - {*LENGTHS, *AXES}
    assert not unknown, f"{group}: no sample: say here whether its components {unknown} are lengths or angles"
    assert len(group.components) == group.dim
    return [k for k, name in enumerate(group.components) if name in AXES]


def tangent(group: LieGroup, shape: tuple[int, ...], angle: float, rng: np.random.Generator) -> Array:
    """Random tangent vectors that turn by a given angle."""
    delta = rng.normal(size=(*shape, group.dim)) * 2.0
    k = turning(group)
    if k:
        axis = rng.normal(size=(*shape, len(k)))
        delta[..., k] = angle * axis / np.linalg.norm(axis, axis=-1, keepdims=True)
    return delta


def element(group: LieGroup, shape: tuple[int, ...], rng: np.random.Generator, largest: float = np.pi) -> Array:
    return group.exp(tangent(group, shape, float(rng.uniform(0.1, largest)), rng))


def form(group: LieGroup, X: Array) -> Array:
    """Elements as numbers that are the same for the same element: homogeneous matrices, or the stored vectors."""
    if not group.point_dim:
        k = turning(group)
        return np.concatenate([np.delete(X, k, axis=-1), np.cos(X[..., k]), np.sin(X[..., k])], axis=-1)
    k = group.point_dim
    M = np.zeros((*X.shape[:-1], k + 1, k + 1))
    M[..., :k, :k] = group.rotation(X)
    M[..., :k, k] = group.act(X, np.zeros(k))
    M[..., k, k] = 1.0
    return M


def assert_same(group: LieGroup, X: Array, Y: Array, atol: float = 1e-12) -> None:
    np.testing.assert_allclose(form(group, X), form(group, Y), rtol=1e-12, atol=atol)


def central(f: Callable[[Array], Array], dim: int, shape: tuple[int, ...]) -> Array:
    """Derivative at 0 of a function of tangent vectors, columns last; all steps in one call, as a leading axis."""
    steps = (STEP * np.eye(dim)).reshape(dim, *[1] * len(shape), dim)
    return np.moveaxis((f(steps) - f(-steps)) / (2 * STEP), 0, -1)


def test_every_group_class_has_an_instance_that_is_tested() -> None:
    classes = {c for m in MODULES for c in vars(m).values() if inspect.isclass(c) and issubclass(c, LieGroup)}
    concrete = {c for c in classes if not inspect.isabstract(c)}
    assert concrete <= {type(group) for group in GROUPS}, "a group without an instance: name one in its module"
    assert {"SO2", "SE2", "SO3", "SE3"} <= {group.name for group in GROUPS}
    for group in GROUPS:
        assert len(set(group.components)) == group.dim
        assert group.identity(4).shape == (4, group.size)
        assert not turning(group) or group.name in OTHER_FORMS, f"{group}: no sample: add its other stored forms here"


@every_group
@given(seed=seeds, shape=st.sampled_from(SHAPES))
def test_axioms(group: LieGroup, seed: int, shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(seed)
    X, Y, Z = (element(group, shape, rng) for _ in range(3))
    neutral = group.identity()[0]
    assert_same(group, group.compose(group.compose(X, Y), Z), group.compose(X, group.compose(Y, Z)))
    assert_same(group, group.compose(X, neutral), X)
    assert_same(group, group.compose(neutral, X), X)
    identities = np.broadcast_to(neutral, X.shape)
    assert_same(group, group.compose(X, group.inverse(X)), identities)
    assert_same(group, group.compose(group.inverse(X), X), identities)
    assert_same(group, group.inverse(group.compose(X, Y)), group.compose(group.inverse(Y), group.inverse(X)))
    assert_same(group, group.between(X, Y), group.compose(group.inverse(X), Y))
    assert_same(group, group.compose(X, group.between(X, Y)), Y)
    for found in (X, group.compose(X, Y), group.inverse(X), group.between(X, Y)):
        assert found.shape == (*shape, group.size)
        assert group.invalid(found.reshape(-1, group.size)) is None
        if group.point_dim == 2 and len(turning(group)):
            assert (found[..., -1] >= -np.pi).all()
            assert (found[..., -1] < np.pi).all()


@every_group
@given(seed=seeds, shape=st.sampled_from(SHAPES))
def test_steps_on_the_right_and_their_adjoints(group: LieGroup, seed: int, shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(seed)
    X, Y = element(group, shape, rng), element(group, shape, rng)
    delta = tangent(group, shape, float(rng.uniform(0, 3.1)), rng)
    moved = group.retract(X, delta)
    assert group.local(X, Y).shape == (*shape, group.dim)
    assert_same(group, group.retract(X, group.local(X, Y)), Y)
    np.testing.assert_allclose(group.local(X, moved), delta, atol=1e-11)
    assert_same(group, moved, group.compose(X, group.exp(delta)))
    Ad = group.adjoint(X)
    assert Ad.shape == (*shape, group.dim, group.dim)
    assert_same(group, moved, group.compose(group.exp((Ad @ delta[..., None])[..., 0]), X), 1e-11)
    np.testing.assert_allclose(group.adjoint(group.compose(X, Y)), Ad @ group.adjoint(Y), atol=1e-10)
    np.testing.assert_allclose(group.adjoint_inverse(X) @ Ad, np.broadcast_to(np.eye(group.dim), Ad.shape), atol=1e-12)
    if group.point_dim:
        p = rng.normal(size=(*shape, group.point_dim))
        np.testing.assert_allclose(group.act(group.compose(X, Y), p), group.act(X, group.act(Y, p)), atol=1e-12)
        np.testing.assert_allclose(group.act(group.inverse(X), group.act(X, p)), p, atol=1e-12)
        np.testing.assert_allclose(group.act(group.identity()[0], p), p)
        turned, t = (group.rotation(X) @ p[..., None])[..., 0], group.position(X)
        np.testing.assert_allclose(group.act(X, p), turned + t if t.shape[-1] else turned, atol=1e-14)


@for_all(group=GROUPS, shape=SHAPES, angle=ANGLES)
def test_exp_and_log_undo_each_other(group: LieGroup, shape: tuple[int, ...], angle: float) -> None:
    rng = np.random.default_rng(11)
    delta = tangent(group, shape, angle, rng)
    X = group.exp(delta)
    assert X.shape == (*shape, group.size)
    found = group.log(X)
    k = turning(group)
    assert np.abs(found - delta)[..., k].max(initial=0.0) <= 2e-15 * angle, "relative to the angle, however small"
    np.testing.assert_allclose(found, delta, rtol=0, atol=1e-13)
    assert_same(group, group.exp(found), X)
    assert_same(group, group.exp(-delta), group.inverse(X), 1e-13)


@for_all(group=GROUPS)
def test_half_a_turn(group: LieGroup) -> None:
    X = group.exp(tangent(group, (20,), np.pi, np.random.default_rng(12)))
    found = group.log(X)
    assert_same(group, group.exp(found), X)
    if k := turning(group):
        assert np.linalg.norm(found[:, k], axis=-1) == pytest.approx(np.pi, abs=1e-14)
    np.testing.assert_array_equal(group.log(group.identity(2)), np.zeros((2, group.dim)))
    sizes = [np.linalg.norm(v, axis=1) for v in (group.coordinates(X), group.local(group.identity(20), X))]
    assert (np.abs(sizes[0] / sizes[1] - 1) < 0.4).all()  # a half turn is the farthest from its tangent step
    assert np.array_equal(group.retract(np.asfortranarray(X), np.zeros((20, group.dim))), X)  # to the last bit
    assert_same(group, group.exp(np.zeros((2, group.dim))), group.identity(2))


@for_all(group=GROUPS, angle=ANGLES)
def test_exp_is_the_matrix_exponential_in_the_named_order(group: LieGroup, angle: float) -> None:
    if not group.point_dim:
        assert group.exp([1.0, *[0.0] * (group.dim - 1)]) == pytest.approx(np.eye(group.dim)[0])
        return
    k = group.point_dim
    generators = np.zeros((group.dim, k + 1, k + 1))
    for G, name in zip(generators, group.components, strict=True):
        if name in LENGTHS:
            G[LENGTHS.index(name), k] = 1.0
        elif k == 2:
            G[:2, :2] = [[0, -1], [1, 0]]
        else:
            G[:3, :3] = np.cross(np.eye(3)[AXES.index(name)], np.eye(3)).T  # columns: axis x e
    delta = tangent(group, (), angle, np.random.default_rng(13))
    np.testing.assert_allclose(form(group, group.exp(delta)), expm(np.tensordot(delta, generators, 1)), atol=1e-13)


@for_all(group=GROUPS, shape=SHAPES, angle=ANGLES)
def test_jacobians_of_exp_and_log(group: LieGroup, shape: tuple[int, ...], angle: float) -> None:
    delta = tangent(group, shape, angle, np.random.default_rng(14))
    X, dim = group.exp(delta), group.dim
    left = central(lambda d: group.log(group.compose(group.exp(delta + d), group.inverse(X))), dim, shape)
    right = central(lambda d: group.log(group.between(X, group.exp(delta + d))), dim, shape)
    jl, jr, jl_inv, jr_inv = (J(delta) for J in (group.jl, group.jr, group.jl_inv, group.jr_inv))
    np.testing.assert_allclose(jl, left, atol=2e-9)
    np.testing.assert_allclose(jr, right, atol=2e-9)
    eye = np.broadcast_to(np.eye(dim), (*shape, dim, dim))
    np.testing.assert_allclose(jl_inv @ jl, eye, atol=1e-13)
    np.testing.assert_allclose(jr_inv @ jr, eye, atol=1e-13)
    np.testing.assert_allclose(jl, group.adjoint(X) @ jr, atol=1e-12)
    if angle < 3.1:
        left = central(lambda d: group.log(group.compose(group.exp(d), X)), dim, shape)
        right = central(lambda d: group.log(group.compose(X, group.exp(d))), dim, shape)
        np.testing.assert_allclose(jl_inv, left, atol=2e-9)
        np.testing.assert_allclose(jr_inv, right, atol=2e-9)


@for_all(group=GROUPS, shape=SHAPES, angle=ANGLES[:-2])
def test_vector_and_its_jacobians(group: LieGroup, shape: tuple[int, ...], angle: float) -> None:
    X = group.exp(tangent(group, shape, angle, np.random.default_rng(16)))
    for Y in (X, *(other(X) for other in OTHER_FORMS.get(group.name, []))):
        assert group.vector(Y).shape == (*shape, group.dim)
        np.testing.assert_allclose(group.vector(Y), vector_by_hand(group, Y), atol=1e-14)
        left = central(lambda d, Y=Y: group.vector(group.compose(group.exp(d), Y)), group.dim, shape)
        right = central(lambda d, Y=Y: group.vector(group.compose(Y, group.exp(d))), group.dim, shape)
        np.testing.assert_allclose(group.vector_jl(Y), left, atol=2e-9)
        np.testing.assert_allclose(group.vector_jr(Y), right, atol=2e-9)


def vector_by_hand(group: LieGroup, X: Array) -> Array:
    """Translation, then the wrapped angle or the vector part of the quaternion with w >= 0."""
    k = turning(group)
    if not group.point_dim or not len(k):  # plain numbers, angles among them
        return np.concatenate([np.delete(X, k, axis=-1), np.angle(np.exp(1j * X[..., k]))], axis=-1)
    t = group.act(X, np.zeros(group.point_dim)) if group.dim > len(k) else X[..., :0]
    rotation = group.rotation(X)
    if group.point_dim == 2:
        return np.concatenate([t, np.arctan2(rotation[..., 1, 0], rotation[..., 0, 0])[..., None]], axis=-1)
    q = Rotation.from_matrix(rotation.reshape(-1, 3, 3)).as_quat(canonical=True)
    return np.concatenate([t, q[:, :3].reshape(*X.shape[:-1], 3)], axis=-1)


def unary(group: LieGroup) -> list[Callable[[Array], Array]]:
    """Functions of one element."""
    vectors = [group.vector, group.vector_jl, group.vector_jr]
    return [group.log, *vectors, group.adjoint, group.adjoint_inverse, group.position]


@for_all(group=GROUPS, shape=SHAPES)
def test_stored_forms_of_one_element_are_one_element(group: LieGroup, shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(17)
    X, Y = element(group, shape, rng, 3.0), element(group, shape, rng, 3.0)
    for other in OTHER_FORMS.get(group.name, []):
        Z = other(X)
        assert np.abs(Z - X).max() > 1e-4
        for f in unary(group):
            np.testing.assert_allclose(f(Z), f(X), atol=1e-12)
        assert_same(group, Z, X)
        assert_same(group, group.inverse(Z), group.inverse(X))
        assert_same(group, group.compose(Z, Y), group.compose(X, Y))
        assert_same(group, group.between(Z, Y), group.between(X, Y))
        assert_same(group, group.between(Y, Z), group.between(Y, X))
        np.testing.assert_allclose(group.local(Z, Y), group.local(X, Y), atol=1e-12)


@for_all(group=GROUPS)
def test_a_batch_is_its_elements_one_by_one(group: LieGroup) -> None:
    rng, shape = np.random.default_rng(19), (3, 1, 2)
    X, Y, delta = element(group, shape, rng, 3.0), element(group, shape, rng, 3.0), tangent(group, shape, 1.2, rng)
    tangents = [group.exp, group.jl, group.jr, group.jl_inv, group.jr_inv]
    ones = [*((f, (X,)) for f in [*unary(group), group.inverse]), *((f, (delta,)) for f in tangents)]
    twos = [(group.compose, (X, Y)), (group.between, (X, Y)), (group.local, (X, Y)), (group.retract, (X, delta))]
    for f, arguments in (*ones, *twos):
        found = f(*arguments)
        for index in np.ndindex(shape):
            alone = f(*(a[index] for a in arguments))
            np.testing.assert_allclose(found[index], alone, rtol=1e-13, atol=1e-14, err_msg=str(f))


@for_all(group=GROUPS)
def test_stack_refuses_what_is_no_element(group: LieGroup) -> None:
    X = element(group, (3,), np.random.default_rng(21))
    np.testing.assert_array_equal(group.stack(X), X)
    np.testing.assert_array_equal(group.stack(X[0]), X[:1])
    wrong = f"{group}: elements have shape (2, {group.size + 1}), expected (n, {group.size})"
    with pytest.raises(GraphError, match=re.escape(wrong)):
        group.stack(np.zeros((2, group.size + 1)))
    X[1, -1] = np.nan
    with pytest.raises(GraphError, match=r"element 1 .*not finite"):
        group.stack(X)
    with pytest.raises(GraphError, match="expected numbers"):
        group.stack([["a"] * group.size])
    if group in (SO3, SE3):
        X = group.identity(3)
        X[2, -4:] = 0.0
        with pytest.raises(GraphError, match=r"element 2 .* length 0, expected 1"):
            group.stack(X)


@for_all(group=GROUPS, shape=SHAPES)
def test_motion_has_the_derivative_it_says(group: LieGroup, shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(22)
    X0 = element(group, shape, rng, 1.0)
    X = group.retract(X0, tangent(group, shape, 0.6, rng))
    c, J = group.motion(X0, X)
    for k, step in enumerate(STEP * np.eye(group.dim)):
        there, back = (group.motion(X0, group.retract(X, s * step))[0] for s in (1, -1))
        np.testing.assert_allclose(J[..., k], (there - back) / (2 * STEP), atol=1e-8)
    np.testing.assert_allclose(group.motion(X0, X0)[0], np.zeros_like(c), atol=1e-12)


@for_all(group=GROUPS)
def test_world_axes(group: LieGroup) -> None:
    """Of the position; and of the rotation of the world that takes R(X) to R(X Exp(delta))."""
    X = element(group, (7,), np.random.default_rng(23))
    G, k = group.world_axes(X), group.position(X).shape[-1]
    assert G.shape == (7, group.dim, group.dim)
    moved = central(lambda d: group.position(group.retract(X, d)), group.dim, (7,))
    np.testing.assert_allclose(G[:, :k], moved, atol=1e-9)
    if group.point_dim and len(turning(group)):
        turn = central(lambda d: group.rotation(group.retract(X, d)) @ group.rotation(X).mT, group.dim, (7,))
        about = [(2, 1), (0, 2), (1, 0)] if group.point_dim == 3 else [(1, 0)]
        np.testing.assert_allclose(G[:, k:], np.stack([turn[:, i, j] for i, j in about], axis=1), atol=1e-9)
    assert group.body_axes is bool((G != np.eye(group.dim)).any())  # declared where they differ from the world
    np.testing.assert_allclose(G @ G.mT, np.broadcast_to(np.eye(group.dim), G.shape), atol=1e-12)
    np.testing.assert_array_equal(group.world_axes(X[3]), G[3])


def test_vector_spaces_are_one_object_each() -> None:
    assert R(2) is R(2)
    assert R(np.int64(2)) is R(2)  # type: ignore[arg-type]
    assert repr(R(3)) == "R(3)"
    for bad in (0, -1, 1.5, "2"):
        with pytest.raises(OptionError, match=r"R\(n\): .* expected a whole number"):
            R(bad)  # type: ignore[arg-type]
    with pytest.raises(GraphError, match=r"R\(4\) has no rotation"):
        R(4).rotation(np.zeros(2))


@for_all(group=GROUPS)
def test_the_misfit_of_elements_with_frames_is_that_without(group: LieGroup) -> None:
    rng = np.random.default_rng(7)
    X, Y, Z = (np.asfortranarray(group.exp(rng.normal(size=(9, group.dim)))) for _ in range(3))
    framed = [group.framed(group.framed(elements)) for elements in (X, Y, Z)]
    (off, J), (same, same_J) = group.misfit(*framed), LieGroup.misfit(group, X, Y, Z)
    for a, b in ((off, same), (J, same_J), (group.misfit(*framed, jacobians=False)[0], same)):
        np.testing.assert_allclose(a, b, atol=1e-13)
