"""Laws of the algebra on random dual quaternions, and its matrices against the printed ones."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from identify.dual_quaternions import algebra as dq
from identify.dual_quaternions.placements import placed
from identify.errors import InputError

SEEDS = st.integers(0, 2**32 - 1)
CLOSE = {"rtol": 1e-12, "atol": 1e-12}


def any_of(rng, *shape):
    return rng.normal(size=(*shape, 8))


def units(rng, *shape):
    turns = rng.normal(size=(*shape, 4))
    return placed(turns / np.linalg.norm(turns, axis=-1, keepdims=True), rng.normal(size=(*shape, 3)))


def quaternion_matrix_plus(p):
    """Eq. 42, as printed."""
    p0, p1, p2, p3 = p
    return np.array([[p0, -p1, -p2, -p3], [p1, p0, -p3, p2], [p2, p3, p0, -p1], [p3, -p2, p1, p0]])


def quaternion_matrix_minus(q):
    """Eq. 43, as printed."""
    q0, q1, q2, q3 = q
    return np.array([[q0, -q1, -q2, -q3], [q1, q0, q3, -q2], [q2, -q3, q0, q1], [q3, q2, -q1, q0]])


def test_quaternion_units_multiply_as_hamilton_says_and_the_dual_unit_squares_to_zero():
    one, i, j, k, eps = np.eye(8)[:5]
    for a, b, c in ((i, j, k), (j, k, i), (k, i, j)):
        np.testing.assert_array_equal(dq.product(a, b), c)
        np.testing.assert_array_equal(dq.product(b, a), -c)
        np.testing.assert_array_equal(dq.product(a, a), -one)
    np.testing.assert_array_equal(dq.product(eps, eps), np.zeros(8))
    np.testing.assert_array_equal(dq.product(eps, i), np.eye(8)[5])


@given(SEEDS)
def test_products_are_associative_and_distribute_over_sums(seed):
    a, b, c = any_of(np.random.default_rng(seed), 3, 5)
    np.testing.assert_allclose(dq.product(dq.product(a, b), c), dq.product(a, dq.product(b, c)), atol=1e-11, rtol=1e-11)
    np.testing.assert_allclose(dq.product(a, b + c), dq.product(a, b) + dq.product(a, c), **CLOSE)


@given(SEEDS)
def test_units_form_a_group(seed):
    a, b = units(np.random.default_rng(seed), 2, 5)
    dq.unit(dq.product(a, b))
    np.testing.assert_allclose(dq.product(a, dq.conjugate(a)), np.tile(dq.IDENTITY, (5, 1)), **CLOSE)
    np.testing.assert_allclose(dq.inverse(a), dq.conjugate(a), **CLOSE)
    np.testing.assert_array_equal(dq.product(a, dq.IDENTITY), a)


@given(SEEDS)
def test_every_dual_quaternion_with_a_real_part_has_an_inverse_on_both_sides(seed):
    a = any_of(np.random.default_rng(seed), 5)
    one = np.tile(dq.IDENTITY, (5, 1))
    scale = 1e-12 * (1.0 + np.abs(dq.inverse(a)).max()) ** 2
    np.testing.assert_allclose(dq.product(a, dq.inverse(a)), one, atol=scale)
    np.testing.assert_allclose(dq.product(dq.inverse(a), a), one, atol=scale)


@given(SEEDS)
def test_conjugates_are_involutions_and_turn_products_round_or_not(seed):
    a, b = any_of(np.random.default_rng(seed), 2, 5)
    for conjugate, turns in ((dq.conjugate, True), (dq.dual_conjugate, False), (dq.dual_quaternion_conjugate, True)):
        np.testing.assert_array_equal(conjugate(conjugate(a)), a)
        pair = (conjugate(b), conjugate(a)) if turns else (conjugate(a), conjugate(b))
        np.testing.assert_allclose(conjugate(dq.product(a, b)), dq.product(*pair), **CLOSE)
    np.testing.assert_array_equal(dq.dual_quaternion_conjugate(a), dq.conjugate(dq.dual_conjugate(a)))


@given(SEEDS)
def test_the_dual_norm_of_a_product_is_the_product_of_dual_norms(seed):
    """``|q|^2 = q q*`` is a dual number."""
    a, b = any_of(np.random.default_rng(seed), 2, 5)
    square = [dq.product(x, dq.conjugate(x)) for x in (a, b, dq.product(a, b))]
    np.testing.assert_allclose(square[2], dq.product(square[0], square[1]), rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(np.delete(square[2], [0, 4], axis=-1), 0.0, atol=1e-10)


@given(SEEDS)
def test_matrices_are_the_printed_ones_with_the_dual_part_in_the_lower_left_block(seed):
    p, q = any_of(np.random.default_rng(seed), 2)
    for matrix, block, value in (
        (dq.left_matrix(p), quaternion_matrix_plus, p), (dq.right_matrix(q), quaternion_matrix_minus, q)
    ):  # fmt: skip
        real, dual = block(value[:4]), block(value[4:])
        np.testing.assert_array_equal(matrix, np.block([[real, np.zeros((4, 4))], [dual, real]]))
    np.testing.assert_allclose(dq.left_matrix(p) @ q, dq.product(p, q), **CLOSE)
    np.testing.assert_allclose(dq.right_matrix(q) @ p, dq.product(p, q), **CLOSE)


@given(SEEDS)
def test_matrices_represent_products(seed):
    a, b = any_of(np.random.default_rng(seed), 2, 3, 2)
    np.testing.assert_allclose(dq.left_matrix(a) @ dq.left_matrix(b), dq.left_matrix(dq.product(a, b)), **CLOSE)
    np.testing.assert_allclose(dq.right_matrix(b) @ dq.right_matrix(a), dq.right_matrix(dq.product(a, b)), **CLOSE)
    left, right = dq.left_matrix(a), dq.right_matrix(b)
    np.testing.assert_allclose(left @ right, right @ left, **CLOSE)


@given(SEEDS)
def test_the_circle_product_is_the_sum_of_two_scalars_as_the_row_t_says(seed):
    """Eq. 13-16: ``T (F' D)`` with the scalar of ``F_r* D_r`` in row 0 and that of ``F_d* D_d`` in row 4."""
    f, d = any_of(np.random.default_rng(seed), 2)
    row = np.array([1.0, 0, 0, 0, 1, 0, 0, 0])
    real, dual = (quaternion_matrix_plus(part * [1, -1, -1, -1]) for part in (f[:4], f[4:]))
    matrix = np.block([[real, np.zeros((4, 4))], [np.zeros((4, 4)), dual]])
    np.testing.assert_allclose(row @ matrix @ d, dq.circle(f, d), **CLOSE)
    np.testing.assert_allclose(dq.circle(f, d), f @ d, **CLOSE)
    np.testing.assert_allclose(dq.circle(dq.swap(f), dq.swap(d)), dq.circle(f, d), **CLOSE)


@given(SEEDS)
def test_the_bracket_of_dual_vectors_is_their_cross_product(seed):
    a, b = any_of(np.random.default_rng(seed), 2, 4)
    a[:, [0, 4]] = b[:, [0, 4]] = 0.0
    found = dq.bracket(a, b)
    np.testing.assert_allclose(found[:, 1:4], np.cross(a[:, 1:4], b[:, 1:4]), **CLOSE)
    expected = np.cross(a[:, 1:4], b[:, 5:]) + np.cross(a[:, 5:], b[:, 1:4])
    np.testing.assert_allclose(found[:, 5:], expected, **CLOSE)


@given(SEEDS, st.floats(1e-3, 1e3))
def test_normalising_takes_out_scale_and_what_belongs_to_no_placement(seed, factor):
    rng = np.random.default_rng(seed)
    q = units(rng, 4)
    slanted = q.copy()
    slanted[:, 4:] += rng.normal(size=(4, 1)) * q[:, :4]
    np.testing.assert_allclose(dq.normalise(factor * slanted), q, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(dq.normalise(q), q, **CLOSE)


@given(SEEDS)
def test_canonical_is_one_of_q_and_minus_q_and_the_same_for_both(seed):
    q = any_of(np.random.default_rng(seed), 6)
    q[0, 0] = q[1, 0] = q[1, 1] = 0.0
    found = dq.canonical(q)
    np.testing.assert_array_equal(found, dq.canonical(-q))
    np.testing.assert_array_equal(np.abs(found), np.abs(q))
    assert (found[2:, 0] > 0).all()
    assert found[0, 1] > 0
    assert found[1, 2] > 0


def test_arrays_broadcast_and_are_not_changed():
    rng = np.random.default_rng(1)
    a, b = any_of(rng, 4, 1), any_of(rng, 3)
    a.setflags(write=False)
    b.setflags(write=False)
    found = dq.product(a, b)
    assert found.shape == (4, 3, 8)
    np.testing.assert_array_equal(found[2, 1], dq.product(a[2, 0], b[1]))
    assert dq.circle(a, b).shape == (4, 3)
    assert dq.left_matrix(a).shape == (4, 1, 8, 8)


def test_what_is_not_unit_is_named_with_its_value():
    q = units(np.random.default_rng(2), 3)
    np.testing.assert_array_equal(dq.unit(q), q)
    long = q.copy()
    long[1] *= 1.01
    with pytest.raises(InputError, match=r"pose \[1\] .* is not unit: \|r\| = 1.01,"):
        dq.unit(long, "pose")
    slanted = q.copy()
    slanted[2, 4:] += 0.02 * q[2, :4]
    with pytest.raises(InputError, match=r"pose \[2\] .* r\.d = 0\.02 m"):
        dq.unit(slanted, "pose")
    for bad in (np.full(8, np.nan), np.zeros(8), np.append(dq.IDENTITY[:7], np.nan)):
        with pytest.raises(InputError, match="is not unit"):
            dq.unit(bad)


@pytest.mark.parametrize("shape", [(7,), (3, 9), ()])
def test_a_wrong_length_is_named(shape):
    with pytest.raises(InputError, match=re.escape(f"of shape {shape}: the last axis must have 8 numbers")):
        dq.product(np.zeros(shape), dq.IDENTITY)


def test_without_a_real_part_there_is_no_inverse_and_no_unit():
    nothing = np.array([dq.IDENTITY, np.eye(8)[5]])
    with pytest.raises(InputError, match=r"\[1\]: a real part of length 0 .* has no inverse"):
        dq.inverse(nothing)
    with pytest.raises(InputError, match="cannot be normalised"):
        dq.normalise(nothing)


def test_shapes_that_do_not_fit_are_named():
    a, b = np.zeros((3, 8)), np.zeros((2, 8))
    for function in (dq.product, dq.circle):
        with pytest.raises(InputError, match=re.escape("shapes (3, 8) and (2, 8) do not broadcast")):
            function(a, b)
