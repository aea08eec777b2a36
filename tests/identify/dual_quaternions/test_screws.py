"""Logarithm, exponential, interpolation and matrices: exact at all angles, against scipy's matrix exponential."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from identify.arrays import skew
from identify.dual_quaternions import algebra as dq
from identify.dual_quaternions.placements import (
    from_matrix,
    from_rotation,
    placed,
    rotation,
    to_matrix,
    transform,
    translation,
)
from identify.dual_quaternions.screws import (
    DEVIATION_OF_TWIST,
    TWIST_OF_DEVIATION,
    dual_vector,
    exp,
    interpolate,
    log,
    power,
    twist,
)
from identify.errors import InputError

SEEDS = st.integers(0, 2**32 - 1)
#: Angles around which formulas of rotations lose digits: none, a half turn, a full turn; and those between.
ANGLES = st.one_of(
    st.floats(0.0, 2 * np.pi),
    st.builds(lambda base, away: abs(base + away), st.sampled_from([0.0, np.pi, 2 * np.pi]),
              st.builds(lambda p, s: s * 10.0**p, st.floats(-17, -0.3), st.sampled_from([-1, 1]))),
)  # fmt: skip


def twist_of(seed, angle, pitch=0.7):
    """Twist (linear, turning) by ``angle`` about a random axis, which also slides along it by about ``pitch``."""
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    point, slide = rng.normal(size=3), pitch * rng.normal()
    return np.concatenate([angle * np.cross(point, axis) + slide * axis, angle * axis])


def homogeneous(motion):
    generator = np.zeros((4, 4))
    generator[:3, :3], generator[:3, 3] = skew(motion[3:]), motion[:3]
    return expm(generator)


@given(SEEDS, ANGLES)
def test_exponentials_are_those_of_matrices(seed, angle):
    motion = twist_of(seed, angle)
    found = exp(0.5 * dual_vector(motion))
    dq.unit(found)
    np.testing.assert_allclose(to_matrix(found), homogeneous(motion), atol=1e-13 * (1 + np.abs(motion).max()))


@given(SEEDS, ANGLES)
def test_logarithm_and_exponential_undo_each_other_at_every_angle(seed, angle):
    motion = twist_of(seed, angle)
    q = exp(0.5 * dual_vector(motion))
    back = log(q)
    np.testing.assert_allclose(exp(back), dq.canonical(q), rtol=0, atol=1e-14 * (1 + np.abs(motion).max()))
    np.testing.assert_array_equal(log(-q), back)
    if angle < np.pi - 1e-6:
        np.testing.assert_allclose(twist(back) * 2.0, motion, rtol=1e-13, atol=1e-14 * np.abs(motion[:3]).max())
    else:
        assert np.linalg.norm(2.0 * back[1:4]) <= np.pi * (1 + 1e-15)


@given(SEEDS, st.one_of(st.floats(-300, -20), st.floats(-20, -0.5), st.floats(-2.2, -1.5)))
def test_small_motions_keep_all_their_digits(seed, exponent):
    motion = twist_of(seed, 1.0) * 10.0**exponent
    found = 2.0 * twist(log(exp(0.5 * dual_vector(motion))))
    np.testing.assert_allclose(found, motion, rtol=0, atol=4e-16 * np.abs(motion).max())


@given(SEEDS, st.floats(-14, -2))
def test_a_motion_just_short_of_a_full_turn_is_the_small_one_back(seed, exponent):
    """As a number 2 pi - x holds x to 4e-16 rad; no more may be lost."""
    away = 10.0**exponent
    motion = twist_of(seed, 2 * np.pi - away, pitch=0.0)
    found = 2.0 * log(exp(0.5 * dual_vector(motion)))
    axis = motion[3:] / np.linalg.norm(motion[3:])
    np.testing.assert_allclose(found[1:4], -away * axis, atol=4e-15)


def test_the_exact_half_turn_and_the_identity():
    half = np.array([0.0, 0, 1, 0, 0, 0.3, 0, 0.1])
    np.testing.assert_allclose(exp(log(half)), half, atol=1e-16)
    np.testing.assert_array_equal(log(half), log(-half))
    np.testing.assert_array_equal(log(dq.IDENTITY), np.zeros(8))
    np.testing.assert_array_equal(log(-dq.IDENTITY), np.zeros(8))
    np.testing.assert_array_equal(exp(np.zeros(8)), dq.IDENTITY)


@given(SEEDS, ANGLES, st.floats(-2, 2), st.floats(-2, 2))
def test_powers_add(seed, angle, first, second):
    q = exp(0.5 * dual_vector(twist_of(seed, angle)))
    together = dq.product(power(q, first), power(q, second))
    scale = 1e-13 * (1 + np.abs(q).max())
    np.testing.assert_allclose(together, power(q, first + second), atol=scale)
    np.testing.assert_allclose(power(q, 1.0), dq.canonical(q), atol=scale)
    np.testing.assert_allclose(power(q, -1.0), dq.conjugate(dq.canonical(q)), atol=scale)


@given(SEEDS)
def test_interpolation_goes_from_end_to_end_at_constant_twist_the_short_way_round(seed):
    rng = np.random.default_rng(seed)
    a, b = (exp(0.5 * dual_vector(rng.normal(size=6) * 2.0)) for _ in range(2))
    shares = np.linspace(0, 1, 5)
    path = interpolate(a, b, shares)
    np.testing.assert_allclose(to_matrix(path[[0, -1]]), to_matrix(np.array([a, b])), atol=1e-12)
    steps = dq.product(dq.conjugate(path[:-1]), path[1:])
    np.testing.assert_allclose(steps, np.tile(steps[:1], (4, 1)), atol=1e-12)
    assert np.linalg.norm(2 * log(steps)[0, 1:4]) <= np.pi / 4 + 1e-12
    for other in (interpolate(-a, b, shares), interpolate(a, -b, shares)):
        np.testing.assert_allclose(to_matrix(other), to_matrix(path), atol=1e-12)
    moved = interpolate(dq.product(b, a), dq.product(b, b), shares)
    np.testing.assert_allclose(to_matrix(moved), to_matrix(dq.product(b, path)), atol=1e-11)


@given(SEEDS, ANGLES)
def test_matrices_and_dual_quaternions_are_the_same_placements(seed, angle):
    a, b = homogeneous(twist_of(seed, angle)), homogeneous(twist_of(seed + 1, 1.0))
    p, q = from_matrix(a), from_matrix(b)
    scale = 1e-12 * (1 + np.abs(a).max()) * (1 + np.abs(b).max())
    np.testing.assert_allclose(to_matrix(p), a, atol=scale)
    np.testing.assert_allclose(to_matrix(dq.product(p, q)), a @ b, atol=scale)
    np.testing.assert_allclose(to_matrix(-p), a, atol=scale)
    np.testing.assert_allclose(to_matrix(dq.conjugate(p)), np.linalg.inv(a), atol=scale)


@given(SEEDS, ANGLES)
def test_points_are_carried_by_both_conjugates_and_lines_by_one(seed, angle):
    """Eq. 5 and 8: points ``1 + eps x`` and screws ask for different conjugates on the right."""
    rng = np.random.default_rng(seed)
    matrix = homogeneous(twist_of(seed, angle))
    q, x = from_matrix(matrix), rng.normal(size=(5, 3))
    expected = x @ matrix[:3, :3].T + matrix[:3, 3]
    scale = 1e-12 * (1 + np.abs(matrix).max())
    np.testing.assert_allclose(transform(q, x), expected, atol=scale)
    point = np.concatenate([np.tile([1.0, 0, 0, 0, 0], (5, 1)), x], axis=1)
    carried = dq.product(dq.product(q, point), dq.dual_quaternion_conjugate(q))
    np.testing.assert_allclose(carried, np.concatenate([point[:, :5], expected], axis=1), atol=scale)
    direction = rng.normal(size=(5, 3))
    turned = direction @ matrix[:3, :3].T
    line = dual_vector(np.concatenate([np.cross(x, direction), direction], axis=1))
    moved = dual_vector(np.concatenate([np.cross(expected, turned), turned], axis=1))
    np.testing.assert_allclose(dq.product(dq.product(q, line), dq.conjugate(q)), moved, atol=10 * scale)


def test_a_deviation_is_half_a_twist_and_the_maps_undo_each_other():
    rng = np.random.default_rng(3)
    motion = 1e-7 * rng.normal(size=(6, 6))
    deviation = exp(0.5 * dual_vector(motion)) - dq.IDENTITY
    np.testing.assert_allclose(motion @ DEVIATION_OF_TWIST.T, deviation, atol=1e-13)
    np.testing.assert_allclose(deviation @ TWIST_OF_DEVIATION.T, motion, atol=1e-13)
    np.testing.assert_allclose(TWIST_OF_DEVIATION, np.linalg.pinv(DEVIATION_OF_TWIST), atol=1e-15)
    np.testing.assert_array_equal(TWIST_OF_DEVIATION @ DEVIATION_OF_TWIST, np.eye(6))
    np.testing.assert_array_equal(twist(dual_vector(motion)), motion)


def test_rotations_at_right_angles_and_half_turns_are_exact():
    for matrix in (np.diag([1.0, -1, -1]), np.diag([-1.0, 1, -1]), np.diag([-1.0, -1, 1]), np.eye(3)[[1, 2, 0]]):
        quaternion = from_rotation(matrix)
        np.testing.assert_allclose(rotation(placed(quaternion, np.zeros(3))), matrix, atol=1e-16)
    np.testing.assert_allclose(translation(placed(quaternion, [0.1, 0.2, 0.3])), [0.1, 0.2, 0.3], atol=1e-16)


def test_wrong_input_is_named():
    with pytest.raises(InputError, match="no rotation: R R' differs from 1 by"):
        from_rotation(1.001 * np.eye(3))
    with pytest.raises(InputError, match="no rotation"):
        from_rotation(np.diag([1.0, 1.0, -1.0]))
    with pytest.raises(InputError, match="no rotation"):
        from_rotation(np.full((3, 3), np.nan))
    with pytest.raises(InputError, match="last row"):
        from_matrix(np.ones((4, 4)))
    with pytest.raises(InputError, match=r"\(\.\.\., 4, 4\) expected"):
        from_matrix(np.eye(3))
    with pytest.raises(InputError, match="no scalar parts"):
        exp(dq.IDENTITY)
    with pytest.raises(InputError, match="is not unit"):
        log(2.0 * dq.IDENTITY)
    with pytest.raises(InputError, match=r"end .*is not unit"):
        interpolate(dq.IDENTITY, 2.0 * dq.IDENTITY, 0.5)
    with pytest.raises(InputError, match="is not unit"):
        to_matrix(np.zeros(8))
    with pytest.raises(InputError, match="twist of shape"):
        dual_vector(np.zeros(5))
