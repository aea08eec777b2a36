"""Straight joint moves against a walk in tiny steps."""

from dataclasses import replace

import numpy as np
import pytest

from doe.gaps import gaps_of
from doe.moves import STEP, free_moves
from identify.cell import Box
from identify.errors import InputError
from identify.kinematics import forward
from identify.loads import LoadCase
from identify.units import DEG
from tests.doe.cell_cases import BLOCK, CABINET, UNLOADED, cell, poses


def walked(study, q_from, q_to, load, steps=400):
    """(M,) least gap on the way, m."""
    gaps, share = gaps_of(study), np.linspace(0, 1, steps)[:, None]
    least = []
    for a, b in zip(q_from, q_to, strict=True):
        frames = forward(study.robot, a + share * (b - a))
        own = [gap(frames) for gap in gaps.by_reason.values()]
        least.append(min(g[:, min(load, g.shape[1] - 1)].min() for g in own))
    return np.array(least)


@pytest.mark.parametrize("load", [0, 1])
def test_moves_are_free_where_a_walk_in_small_steps_meets_nothing(load):
    study = cell(boxes=(CABINET,), floor=0.1, loads=(UNLOADED, BLOCK), self_collision=load == 0)
    q = poses(study, 3000)
    ready = [gap(forward(study.robot, q)) for gap in gaps_of(study).by_reason.values()]
    q = q[np.min([g[:, min(load, g.shape[1] - 1)] for g in ready], axis=0) > 0.02][:160]
    q_from, q_to = q[:80], q[80:160]
    free = free_moves(study, q_from, q_to, np.full(80, load))
    least = walked(study, q_from, q_to, load)
    assert not free[least < -STEP].any()
    assert free[least > 0].all()
    assert 5 < free.sum() < 75


def test_a_thin_plate_between_two_poses_is_not_jumped_over():
    plate = Box("plate", np.array([1.6, 0.0, 1.5]), np.array([1.0, 0.0005, 1.5]), np.eye(3))
    study = cell(boxes=(plate,), loads=(UNLOADED,))
    left, right = (np.array([side, -90, 90, 0, 0, 0]) * DEG for side in (-60, 60))
    assert free_moves(study, left, left).all()
    assert not free_moves(study, left, right).any()
    assert free_moves(replace(study, constraints=replace(study.constraints, boxes=())), left, right).all()


def test_a_hung_weight_makes_a_move_impossible_that_is_free_without_it():
    low = Box("table", np.array([2.0, 0.0, 0.5]), np.array([0.6, 0.2, 0.7]), np.eye(3))
    study = cell(boxes=(low,))
    left, right = (np.array([side, -90, 90, 0, 0, 0]) * DEG for side in (-50, 50))
    assert free_moves(study, left, right).tolist() == [True]
    assert free_moves(study, left, right, np.array([0, 1])[:1]).tolist() == [True]
    assert free_moves(study, left, right, np.array([1])).tolist() == [False]


def test_many_moves_from_one_pose_equal_single_ones_and_both_ends_count():
    study = cell(boxes=(CABINET,), floor=0.1, loads=(UNLOADED, LoadCase("P", 10.0)))
    q = poses(study, 40)
    home = np.array([0, -90, 90, 0, 0, 0]) * DEG
    together = free_moves(study, home, q)
    assert together.tolist() == [bool(free_moves(study, home, one)[0]) for one in q]
    np.testing.assert_array_equal(together, free_moves(study, q, home))
    bad = np.array([[0, -5, 150, 0, 0, 0]]) * DEG
    assert not free_moves(study, home, bad).any()
    assert free_moves(study, np.zeros((0, 6)), np.zeros((0, 6))).shape == (0,)


def test_shapes_that_do_not_fit_are_named():
    study = cell()
    with pytest.raises(InputError, match=r"shapes \(2, 6\), \(3, 6\)"):
        free_moves(study, np.zeros((2, 6)), np.zeros((3, 6)))
