"""Array helpers: angles, stacks of small matrices, Stumpff functions."""

from __future__ import annotations

import itertools
from decimal import Decimal, localcontext

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.algebra import apply, arrangement, components, dot, matrix, pack, product, sinc, skew, stumpff, wrap
from tests.combinations import for_all

BATCHES = [((), ()), ((1,), ()), ((), (5,)), ((5,), (5,)), ((1,), (5,)), ((3, 1, 2), (2,)), ((2,), (3, 1, 2))]
BATCHES += [((3, 1, 2), (4, 1)), ((0,), (0,)), ((0,), (1,))]
SHAPES: list[tuple[int, ...]] = [(), (1,), (5,), (3, 1, 2), (0,)]


@given(st.floats(-1e6, 1e6))
def test_wrap_is_the_same_direction_in_range(angle: float) -> None:
    wrapped = float(wrap(angle))
    assert -np.pi <= wrapped < np.pi
    assert np.hypot(np.cos(wrapped) - np.cos(angle), np.sin(wrapped) - np.sin(angle)) < 1e-15 + 1e-15 * abs(angle)


def test_wrap_at_the_ends_of_the_range() -> None:
    below, above = np.nextafter(np.pi, 0.0), np.nextafter(np.pi, 4.0)
    assert float(wrap(np.pi)) == -np.pi
    assert float(wrap(-np.pi)) == -np.pi
    assert float(wrap(below)) == below
    assert -np.pi <= float(wrap(above)) < -3.1415
    assert 3.1415 < float(wrap(-above)) < np.pi or float(wrap(-above)) == -np.pi
    assert wrap([3 * np.pi, -3 * np.pi, 2 * np.pi, 0.0]) == pytest.approx([-np.pi, -np.pi, 0.0, 0.0], abs=1e-15)

    for huge in (1e9, -1e9, 1e15, -1e15, 1e300, -1e300):
        assert -np.pi <= float(wrap(huge)) < np.pi
    turns = np.array([-100_000, -7, -1, 1, 12, 100_000])
    assert wrap(0.5 + 2 * np.pi * turns) == pytest.approx(0.5, abs=1e-9)
    assert wrap(np.zeros((3, 1, 2))).shape == (3, 1, 2)


@for_all(batches=BATCHES)
def test_product_is_matmul_and_dot_the_sum_of_products(batches: tuple[tuple[int, ...], tuple[int, ...]]) -> None:
    rng = np.random.default_rng(0)
    for r, k, c in itertools.product([1, 2, 3, 4, 6], [1, 2, 3, 6], [1, 2, 3, 7]):
        A, B = rng.normal(size=(*batches[0], r, k)), rng.normal(size=(*batches[1], k, c))
        expected, found = A @ B, product(A, B)
        assert found.shape == expected.shape, (r, k, c)
        assert np.abs(found - expected).max(initial=0.0) < 1e-14, (r, k, c)
        x = B[..., 0]
        assert np.abs(apply(A, x) - (A @ x[..., None])[..., 0]).max(initial=0.0) < 1e-14, (r, k, c)
    a, b = rng.normal(size=(*batches[0], 4)), rng.normal(size=(*batches[1], 4))
    assert dot(a, b) == pytest.approx((a * b).sum(axis=-1), abs=1e-15)


def test_product_refuses_inner_sizes_that_differ() -> None:
    for A, B in (((2, 1), (3, 2)), ((2, 3), (1, 2)), ((5, 2, 2), (3, 3))):
        with pytest.raises(ValueError, match="inner sizes"):
            product(np.zeros(A), np.zeros(B))


def test_pack_and_components_undo_each_other() -> None:
    X = np.arange(24.0).reshape(3, 1, 2, 4)
    np.testing.assert_array_equal(pack(components(X)), X)
    x, y = np.arange(3.0), 7.0
    np.testing.assert_array_equal(pack([x, y]), [[0, 7], [1, 7], [2, 7]])
    assert components(pack([x, y]))[0].flags.c_contiguous, "a component of a packed stack is contiguous"


@for_all(batch=SHAPES)
def test_entries_are_put_in_their_places(batch: tuple[int, ...]) -> None:
    rng = np.random.default_rng(2)
    w, v = rng.normal(size=(*batch, 3)), rng.normal(size=(*batch, 3))
    K = skew(w)
    assert K.shape == (*batch, 3, 3)
    np.testing.assert_array_equal(K, -K.mT)
    assert apply(K, v) == pytest.approx(np.cross(w, v), abs=1e-15)
    x, y, z = components(v)
    M = matrix([[x, -y, 0 * z], [-z, y, x]])
    np.testing.assert_array_equal(M[..., 1, 0], -z)
    assert M.shape == (*batch, 2, 3)
    for stored in (v, pack(components(v))):
        np.testing.assert_array_equal(arrangement([[1, -2, 0], [-3, 2, 1]])(stored), M)
    np.testing.assert_array_equal(matrix([[y, 1.0], [3.0, y + 1]])[..., 0, 1], np.ones(batch))


def exact(k: int, x: float) -> float:
    """c_k(x) summed with 60 digits."""
    with localcontext() as context:
        context.prec = 60
        term = Decimal(1)
        for i in range(1, k + 1):
            term /= i
        total, j = Decimal(0), 0
        while abs(term) > Decimal("1e-40"):
            total += term
            term *= -Decimal(x) / ((2 * j + k + 1) * (2 * j + k + 2))
            j += 1
        return float(total)


SWITCH = [2 * (1 + s) for s in (-1e-3, -1e-9, -2e-16, 0.0, 4e-16, 1e-9, 1e-3)]
POINTS = np.array([0.0, 1e-300, 1e-18, 1e-14, 1e-8, 1e-4, 0.1, 0.5, 1.0, 1.5, *SWITCH, 3.0, 5.0, 9.0, 20.0, 39.0])
POINTS = np.append(POINTS, [(np.pi - s) ** 2 for s in (1e-3, 1e-7, 1e-9, 0.0)])


@for_all(k=range(7))
def test_stumpff_against_sixty_digits(k: int) -> None:
    expected = np.array([exact(k, float(x)) for x in POINTS])
    (found,) = stumpff(POINTS, k)
    assert np.abs(found - expected).max() < 5e-16
    alone = np.array([stumpff(np.asarray(x), k)[0] for x in POINTS])
    np.testing.assert_array_equal(alone, found, "a value must not depend on its neighbors in the batch")


@for_all(batch=SHAPES)
def test_stumpff_keeps_order_and_shape(batch: tuple[int, ...]) -> None:
    x = np.random.default_rng(3).uniform(0.0, 9.0, size=batch)
    c4, c0, c2 = stumpff(x, 4, 0, 2)
    assert c4.shape == c0.shape == c2.shape == batch
    assert c0 == pytest.approx(np.cos(np.sqrt(x)), abs=1e-15)
    assert c2 == pytest.approx((1 - c0) / np.where(x > 0, x, 1.0), abs=1e-15)
    assert c4 == pytest.approx((0.5 - c2) / x, abs=1e-14)


def test_sinc_is_one_at_zero_and_even() -> None:
    x = np.array([0.0, -0.0, 5e-324, 1e-300, -1e-300, 1e-9, 1e-3, 1.0, 3.0])
    assert sinc(x)[:6].tolist() == [1.0] * 6
    np.testing.assert_array_equal(sinc(-x), sinc(x))
    assert sinc(x)[6:] == pytest.approx([1 - 1e-6 / 6 + 1e-12 / 120, np.sin(1.0), np.sin(3.0) / 3], abs=1e-16)
    assert np.isnan(sinc(np.array([np.nan]))).all()
